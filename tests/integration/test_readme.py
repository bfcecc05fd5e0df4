"""The example of README.md runs as it stands, but for its domain and how long it takes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

README = (Path(__file__).parents[2] / "README.md").read_text()


def test_the_example_runs(domain_id, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    here = f'"dds.domain": {domain_id}'
    short = '"stream.ramp": 0.5, "stream.duration": 1.0, "safety.state_timeout": 2.0'
    assert '"dds.domain": 3' in example
    names: dict[str, object] = {}
    command = [sys.executable, "-m", "g1stream", "sim", "--domain", str(domain_id)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as sim:
        try:
            exec(example.replace('"dds.domain": 3', f"{here}, {short}"), names)
        finally:
            sim.terminate()
    assert names["summary"].stream.reason == ""
    assert names["tracking"].overall < 0.15
    assert names["tracking"].error.shape[1] == 29
