"""The examples of docs/sessions.md run as they stand, one after the other."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

TEXT = (Path(__file__).parents[2] / "docs" / "sessions.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
HAS_TABLES = importlib.util.find_spec("pandas") and importlib.util.find_spec("pyarrow")


@pytest.mark.slow
def test_the_examples_run(play, write_session, monkeypatch, tmp_path):
    write_session(*play(), {"motion": {"name": "dance"}})
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    assert len(BLOCKS) == 9
    for block in BLOCKS:
        if "to_dataframe" in block and not HAS_TABLES:
            continue
        exec(block, names)
    assert names["motion_name"] == {"name": "dance"}
    assert names["motion"].fps == 30


def test_the_tracking_by_hand_is_the_functions(play, write_session, monkeypatch, tmp_path, capsys):
    write_session(*play(0.04))
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in BLOCKS[:6]:
        exec(block, names)
    assert "40.0 ms behind" in capsys.readouterr().out
    np.testing.assert_allclose(names["error"], names["tracking"].error, atol=1e-9)
    np.testing.assert_allclose(names["rmse"], names["tracking"].rmse, atol=1e-9)


@pytest.mark.skipif(not HAS_TABLES, reason="the extra `export` is not installed")
def test_the_tables_are_those_of_the_text(play, write_session, monkeypatch, tmp_path):
    write_session(*play())
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in BLOCKS[:8]:
        exec(block, names)
    assert len(names["knee"]) == len(names["session"].measured)
    assert all(path.suffix == ".parquet" for path in names["files"])
