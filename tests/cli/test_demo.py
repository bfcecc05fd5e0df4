import pytest

from g1stream.cli.demo import Demo, _write_page
from g1stream.errors import ConfigError, RecordingError


def test_a_page_that_is_there_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "report.html").write_text("precious")
    with pytest.raises(RecordingError, match=r"report\.html exists already"):
        Demo(motion="nowhere.csv", out=tmp_path).run()


def test_without_the_extra_it_is_said_how_to_install_it(tmp_path, monkeypatch, capsys):
    def load(name):
        raise ConfigError("It is not installed.", "pip install it.")

    monkeypatch.setattr("g1stream.cli.demo.extension", load)
    _write_page(tmp_path / "s.mcap", tmp_path / "report.html")
    printed = capsys.readouterr()
    assert "pip install it." in printed.err
    assert printed.out == ""  # where the summary may be JSON
