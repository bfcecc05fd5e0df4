"""The core does not grow back into a matrix: how many of its files know an option."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("structure", ROOT / "benchmarks" / "structure.py")
TOOL = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(TOOL)

#: Core files that know each option. Lower a number when the count falls, and do not raise one:
#: an option that needs another file needs another design (CONTRIBUTING.md, "Add a flag").
MOST = {
    "joints that play, kinds of G1": 49,
    "receiver": 23,
    "source: policy, balance": 28,
    "support": 21,
    "clock of the robot": 8,
    "simulator or robot": 24,
    "recordings of others": 16,
    "foreign formats": 8,
    "parameters of a robot": 12,
}


def test_no_option_reaches_further_into_the_core():
    assert TOOL.structure()["core files that know an option"] == MOST


@pytest.mark.parametrize("text", ["via", "profile"])
def test_a_file_that_names_an_option_is_counted(tmp_path, text):
    """In code and in strings; not in comments and docstrings."""
    package = tmp_path / "src" / "g1stream"
    for folder in ("cli", "tests"):
        (package / folder).mkdir(parents=True)
    (package / "__init__.pyi").write_text("")
    (package / "cli" / "main.py").write_text("")
    (package / "config.py").write_text("class DdsConfig:\n    pass\n")
    (package / "a.py").write_text(f'"""About {text}."""\n\n# {text}\nA = 1\n')
    before = sum(TOOL.structure(tmp_path)["core files that know an option"].values())
    (package / "b.py").write_text(f"{text} = 1\n")
    (package / "c.py").write_text(f"C = '{text}'\n")
    counted = TOOL.structure(tmp_path)
    assert before == 0
    assert sum(counted["core files that know an option"].values()) == 2
    assert counted["core"] == {"files": 5, "lines": 8, "code": 5}
