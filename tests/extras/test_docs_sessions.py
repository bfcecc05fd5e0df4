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
def test_the_examples_run(play, write_session, monkeypatch, tmp_path, capsys):
    write_session(*play(0.04), {"motion": {"name": "dance"}})
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    assert len(BLOCKS) == 9
    for block in BLOCKS:
        if "to_dataframe" not in block or HAS_TABLES:
            exec(block, names)
    assert names["motion_name"] == {"name": "dance"}
    assert names["motion"].fps == 30
    assert "40.0 ms behind" in capsys.readouterr().out
    np.testing.assert_allclose(names["error"], names["tracking"].error, atol=1e-9)
    np.testing.assert_allclose(names["rmse"], names["tracking"].rmse, atol=1e-9)
    if HAS_TABLES:
        assert len(names["knee"]) == len(names["session"].measured)
        assert all(path.suffix == ".parquet" for path in names["files"])
