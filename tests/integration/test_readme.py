"""The Python of README.md runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

README = (Path(__file__).parents[2] / "README.md").read_text()


def test_the_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict[str, object] = {}
    exec(example, names)
    assert names["tracking"].overall < 0.01
    assert names["tracking"].error.shape[1] == 29
    saved = names["g1stream"].open_session("rollout.mcap").tracking()
    assert saved.overall == names["tracking"].overall
    assert Path("knee.png").stat().st_size > 0
