import numpy as np
import pytest

from g1stream.cli.convert import Convert
from g1stream.cli.demo import Demo
from g1stream.cli.flags import parse_flags
from g1stream.cli.motion import Motion
from g1stream.cli.stream import Stream
from g1stream.motion.readers import load_motion


@pytest.mark.parametrize(
    ("kind", "given"),
    [(Stream, ["a.csv"]), (Motion, ["a.csv"]), (Convert, ["a.csv", "b.npz"]), (Demo, [])],
)
def test_what_a_file_does_not_say_is_told_before_it_is_played(kind, given, tmp_path):
    path = tmp_path / "bare.csv"
    np.savetxt(path, load_motion("demo").joint_pos, delimiter=",")
    found = [
        parse_flags(kind, kind.__name__.lower(), "", [*given, *fps]).load([str(path)]).warnings
        for fps in ([], ["--fps", "30"])
    ]
    rate = "bare.csv: frame rate: 30 fps, assumed."
    assert [rate in warnings for warnings in found] == [True, False]
