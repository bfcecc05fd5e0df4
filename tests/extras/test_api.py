import importlib
import re
import runpy
from pathlib import Path

import pytest

import g1stream

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "g1stream"


@pytest.mark.parametrize(("name", "module"), g1stream._HOME.items())
def test_a_public_name_is_the_one_of_its_module(name, module):
    made_in = importlib.import_module(f"g1stream.{module}")
    assert getattr(g1stream, name) is getattr(made_in, name)
    assert name in made_in.__all__


def test_no_public_name_is_hidden_by_a_module_of_that_name():
    """Importing `g1stream.x` anywhere sets the attribute `x` of the package."""
    modules = {path.stem for path in PACKAGE.iterdir()}
    assert not modules & set(g1stream.__all__)


def test_the_stub_has_every_public_name():
    tool = runpy.run_path(str(ROOT / "tools" / "make_stub.py"))
    assert tool["stub"]() == (PACKAGE / "__init__.pyi").read_text(), "run make docs"


def test_every_public_name_is_on_one_page_of_the_api():
    text = "\n".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    shown = re.findall(r"^(?:::: |\{\{ fields )g1stream\.(\w+)", text, re.MULTILINE)
    assert sorted([*shown, "JOINT_NAMES"]) == sorted(g1stream._HOME)
