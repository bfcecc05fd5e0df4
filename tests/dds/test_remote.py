import pytest

from g1stream.dds.messages import LowState
from g1stream.dds.remote import BUTTONS, Operator, button_mask
from g1stream.errors import ConfigError

#: Byte and bit of each button, as the SDK's joystick class lists them, highest bit first.
IN_BYTE_2 = ("", "", "L2", "R2", "select", "start", "L1", "R1")
IN_BYTE_3 = ("left", "down", "right", "up", "Y", "X", "B", "A")


def made(pressed=()):
    data = bytearray(40)
    for byte, names in ((2, IN_BYTE_2), (3, IN_BYTE_3)):
        for i, name in enumerate(names):
            if name in pressed:
                data[byte] |= 0x80 >> i
    return bytes(data)


def bits(*pressed):
    return int.from_bytes(made(pressed)[2:4], "little")


def test_each_button_is_its_own_bit():
    for name in filter(None, (*IN_BYTE_2, *IN_BYTE_3)):
        assert button_mask(name, "x") == bits(name) == 1 << BUTTONS.index(name)


def test_the_buttons_of_a_low_state():
    state = LowState()
    state.wireless_remote[:] = list(made(("L2", "B", "left")))
    assert state.buttons == bits("L2", "B", "left")


def test_a_combination_needs_all_its_buttons():
    operator = Operator(("L2+B", "select"), None)
    for pressed in ((), ("L2",), ("B",), ("start", "A")):
        assert operator.stop_reason(bits(*pressed)) == ""
        assert operator.missing(bits(*pressed)) == ""
    assert "L2+B" in operator.stop_reason(bits("L2", "B", "up"))
    assert "L2+B" in operator.missing(bits("L2", "B"))
    assert "select" in operator.stop_reason(bits("select"))


def test_a_dead_man_switch_is_waited_for_and_stops_when_released():
    operator = Operator((), "R1")
    assert "safety.deadman" in operator.missing(bits("L1"))
    assert operator.missing(bits("R1", "A")) == operator.stop_reason(bits("R1")) == ""
    assert "R1" in operator.stop_reason(0)


def test_a_resting_motion_goes_on_once_each_time_the_button_is_pressed():
    operator = Operator((), None, "R1+A")
    pressed = ((), ("A",), ("A", "R1"), ("A", "R1", "up"), ("R1",), ("A", "R1"))
    found = [operator.goes_on(bits(*one)) for one in pressed]
    assert found == [False, False, True, False, False, True]
    for other in (None, "enter"):
        assert not any(Operator((), None, other).goes_on(bits(*one)) for one in pressed)


def test_an_unknown_button_is_refused():
    for wrong in ("Enter", ""):
        with pytest.raises(ConfigError, match=r"stream\.wait_for"):
            Operator((), None, wrong)


def test_a_button_that_stops_the_robot_lets_nothing_go_on():
    for wait_for in ("R1", "R1+A", "select", "L2+B+A"):
        with pytest.raises(ConfigError, match="wait_for"):
            Operator(("L2+B", "select"), "R1", wait_for)
    assert Operator(("L2+B", "select"), "R1", "B").goes_on(bits("B"))


def test_a_misspelt_deadman_is_refused():
    with pytest.raises(ConfigError, match=r"safety\.deadman = 'R1\+Z'.*'Z'"):
        Operator((), "R1+Z")
    with pytest.raises(ConfigError, match=r"safety\.stop_buttons"):
        Operator(("",), None)
    assert button_mask("l2 + b", "x") == bits("L2", "B")
