"""The public names: all of them are there, documented, and cheap to import."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import subprocess
import sys
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


def classes() -> set[str]:
    """The names of all classes of the package."""
    nodes = (one for path in PACKAGE.rglob("*.py") for one in ast.walk(ast.parse(path.read_text())))
    return {one.name for one in nodes if isinstance(one, ast.ClassDef)}


def returned() -> dict[str, str]:
    """Public function, method or property -> its return annotation."""
    found = {}
    for name in g1stream.__all__:
        public = getattr(g1stream, name)
        members = {name: public}
        if inspect.isclass(public):
            ours = [one for one in public.__mro__ if one.__module__.startswith("g1stream")]
            members = {f"{name}.{key}": one for base in ours for key, one in vars(base).items()}
        for key, member in members.items():
            function = member
            for attribute in ("fget", "func", "__func__"):
                function = getattr(function, attribute, function)
            annotation = getattr(function, "__annotations__", {}).get("return")
            if annotation and "._" not in key:
                found[key] = str(annotation)
    return found


def test_every_returned_class_is_public():
    found, ours = returned(), classes()
    assert found["Session.reference"] == "Reference"
    assert found["G1.load"] == "G1"
    missing = {
        key: name
        for key, annotation in found.items()
        for name in set(re.findall(r"\w+", annotation)) & ours
        if name not in g1stream.__all__
    }
    assert not missing


def test_api_docs_are_made_of_the_docstrings():
    path = ROOT / "tools" / "make_api_docs.py"
    spec = importlib.util.spec_from_file_location("make_api_docs", path)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    text = (ROOT / "docs" / "api.md").read_text()
    assert tool.api_docs() == text, "run make docs"
    assert tool.stub() == (PACKAGE / "__init__.pyi").read_text(), "run make docs"
    assert " at 0x" not in text


def test_importing_loads_nothing_heavy():
    code = "import sys, g1stream; print('numpy' in sys.modules, 'cyclonedds' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
