import pytest

from g1stream.cli.demo import Demo
from g1stream.errors import RecordingError


def test_a_page_that_is_there_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "report.html").write_text("precious")
    with pytest.raises(RecordingError, match=r"report\.html exists already"):
        Demo(motion="nowhere.csv", out=tmp_path).run()
