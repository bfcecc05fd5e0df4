import pytest

from g1stream.text import printable, ranges, told_apart


def test_what_a_terminal_would_obey_is_escaped():
    assert printable("a\x1b[2Jb\nc") == r"a\x1b[2Jb\nc"
    assert printable("rad/s², 29 °C") == "rad/s², 29 °C"


def test_ranges_of_frames():
    spans = [(0, 3), (7, 7), (9, 12)]
    assert ranges(spans, 3) == "0 to 3, 7, 9 to 12"
    assert ranges(spans, 1) == "0 to 3 and 2 more spans"


@pytest.mark.parametrize(
    ("value", "limit", "texts"),
    [
        (0.26184, 0.2618, ("0.26184", "0.26180")),
        (0.3, 0.2618, ("0.300", "0.262")),
        (0.25, 0.25, ("0.250", "0.250")),
        (-0.2618001, -0.2618, ("-0.2618001", "-0.2618000")),
    ],
)
def test_a_value_beyond_a_limit_differs_from_it(value, limit, texts):
    assert told_apart(value, limit) == texts
