from g1stream.text import printable, ranges


def test_what_a_terminal_would_obey_is_escaped():
    assert printable("a\x1b[2Jb\nc") == r"a\x1b[2Jb\nc"
    assert printable("rad/s², 29 °C") == "rad/s², 29 °C"


def test_ranges_of_frames():
    spans = [(0, 3), (7, 7), (9, 12)]
    assert ranges(spans, 3) == "0 to 3, 7, 9 to 12"
    assert ranges(spans, 1) == "0 to 3 and 2 more spans"
