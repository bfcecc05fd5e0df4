import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from g1stream.cli.flags import parse_flags
from g1stream.cli.main import COMMANDS, load_command

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {str(path.relative_to(ROOT)): path.read_text() for path in sorted(DOCS.rglob("*.md"))}
PAGES["README.md"] = (ROOT / "README.md").read_text()

#: They need a session beside them; the other pages with Python need a robot, or a cluster.
OF_A_SESSION = ["docs/topics-and-clocks.md", "docs/metrics.md", "docs/policy.md"]
HAS_TABLES = importlib.util.find_spec("pandas") and importlib.util.find_spec("pyarrow")


def python_of(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGES[page], flags=re.DOTALL)


def commands_of(page: str) -> list[list[str]]:
    """The words of each command of g1stream in code and in tables, but synopses with brackets."""
    text = re.sub(r"\\\n\s*", "", PAGES[page])
    code = [*re.findall(r"^    .*$", text, re.MULTILINE), *re.findall(r"^```[^`]*^```", text, re.M)]
    lines = re.findall(r"^ *(?:uvx .* )?(g1stream [a-z].*)$", "\n".join(code), re.MULTILINE)
    lines += re.findall(r"^\| `(g1stream [a-z][^`\n]*)` \|", text, re.MULTILINE)
    found = []
    for line in lines:
        words = shlex.split(line.partition(" && ")[0], comments=True)
        if "|" in words:
            words = words[: words.index("|")]
        if not any("[" in word for word in words) and words[1] in COMMANDS:
            found.append(words[1:])
    return found


@pytest.mark.parametrize("page", [page for page in PAGES if python_of(page)])
def test_the_python_of_a_page_compiles(page):
    for block in python_of(page):
        compile(block, page, "exec")


@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)])
def test_the_commands_of_a_page_have_these_flags(page):
    for name, *arguments in commands_of(page):
        if not {"...", "--help"} & set(arguments):
            parse_flags(load_command(name), name, "", arguments)


def test_the_page_of_commands_has_every_command():
    assert {name for name, *_ in commands_of("docs/commands.md")} == set(COMMANDS)


def test_the_tables_of_pages_are_what_the_program_uses():
    path = ROOT / "tools" / "make_support_page.py"
    spec = importlib.util.spec_from_file_location("make_support_page", path)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.TABLES
    for name in tool.TABLES:
        page = PAGES[f"docs/{name}"]
        assert tool.with_tables(page, name) == page, "run tools/make_support_page.py"
    assert tool.support_page() == PAGES["docs/support.md"], "run tools/make_support_page.py"


@pytest.fixture
def here(play, write_session, monkeypatch, tmp_path):
    """A working directory with session.mcap in it."""
    write_session(*play(0.04), {"motion": {"name": "dance"}})
    monkeypatch.chdir(tmp_path)


def run_python_of(page):
    names = {}
    for block in python_of(page):
        if "to_dataframe" not in block or HAS_TABLES:
            exec(block, names)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("page", OF_A_SESSION)
def test_the_python_of_a_page_runs(here, page):
    assert run_python_of(page)


@pytest.mark.slow
def test_the_examples_about_sessions_say_what_they_should(here, capsys):
    names = run_python_of("docs/sessions.md")
    assert names["motion_name"] == {"name": "dance"}
    assert names["motion"].fps == 30
    assert "40.0 ms behind" in capsys.readouterr().out
    if HAS_TABLES:
        np.testing.assert_allclose(names["rmse"], names["tracking"].rmse, atol=1e-9)
        assert len(names["knee"]) == len(names["session"].measured)
        assert all(path.suffix == ".parquet" for path in names["files"])


@pytest.mark.slow
def test_the_site_is_built_with_no_broken_link(tmp_path):
    pytest.importorskip("material", reason="the extra `docs` is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*.html")}
    assert "<math" in pages["metrics.html"]
    assert "arithmatex" not in pages["metrics.html"]
    for name, page in pages.items():
        loaded = re.findall(r'<(?:script|link|img|iframe)\b[^>]*?(?:src|href)="(\w+:)?//', page)
        assert not loaded, f"{name} loads something from a network"
