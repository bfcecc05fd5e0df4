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


@pytest.mark.parametrize("extra", g1stream._EXTRAS)
def test_an_extra_has_its_names(extra):
    package = getattr(g1stream, extra)
    for name in package.__all__:
        made_in = importlib.import_module(getattr(package, name).__module__)
        assert getattr(package, name) is getattr(made_in, name)
        assert name in made_in.__all__
    with pytest.raises(AttributeError):
        _ = package.nothing


def test_no_public_name_is_hidden_by_a_module_of_that_name():
    """Importing `g1stream.x` anywhere sets the attribute `x` of the package."""
    assert not {path.stem for path in PACKAGE.iterdir()} & set(g1stream.__all__)
    for extra in g1stream._EXTRAS:
        modules = {path.stem for path in (PACKAGE / "extras" / extra).glob("*.py")}
        assert not modules & set(getattr(g1stream, extra).__all__)


def test_the_stub_has_every_public_name():
    tool = runpy.run_path(str(ROOT / "tools" / "make_stub.py"))
    assert tool["stub"]() == (PACKAGE / "__init__.pyi").read_text(), "run make docs"


def test_every_public_name_is_on_one_page_of_the_api():
    text = "\n".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    shown = re.findall(r"^(?:::: |\{\{ fields )g1stream\.([\w.]+)", text, re.MULTILINE)
    assert len(shown) == len(set(shown))
    extras = {
        f"{one}.{name}" for one in g1stream._EXTRAS for name in getattr(g1stream, one).__all__
    }
    assert {*g1stream._HOME, *extras} - {"JOINT_NAMES"} <= set(shown)
