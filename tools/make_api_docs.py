"""Writes docs/api.md from the docstrings of the names that g1stream exports, and their stub.

python tools/make_api_docs.py
"""

from __future__ import annotations

import inspect
import re
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

import g1stream

PATH = Path(__file__).parents[1] / "docs" / "api.md"
STUB = Path(g1stream.__file__).with_suffix(".pyi")

_HEAD = """\
# Python API

Everything that `import g1stream` offers. Made from the docstrings by `make docs`.
"""
_SECTION = re.compile(r"(Args|Attributes|Returns|Yields|Raises):")
_ENTRY = re.compile(r"    (\*{0,2}\w+(?:, \w+)*): (.*)")


class _Source(str):
    """Python source, which `inspect.Signature` shows as it is, without quotes."""

    __slots__ = ()
    __repr__ = str.__str__


def api_docs() -> str:
    """The text of docs/api.md."""
    exported = [(name, getattr(g1stream, name)) for name in sorted(g1stream.__all__)]
    functions = [(name, one) for name, one in exported if inspect.isfunction(one)]
    classes = [(name, one) for name, one in exported if inspect.isclass(one)]
    constants = [name for name, one in exported if not callable(one)]
    parts = [_HEAD, "## Functions\n"]
    parts += [f"### {name}\n\n{_code(name, one)}{_text(one)}" for name, one in functions]
    parts += ["## Classes\n", *(_class(name, one) for name, one in classes)]
    nested = sorted(_nested(classes).items())
    parts += ["## Tables of Config and parts of Summary\n", *(_class(*one) for one in nested)]
    parts += [f"## Constants\n\n{', '.join(f'`{name}`' for name in constants)}\n"]
    return "\n".join(parts)


def stub() -> str:
    """The text of g1stream/__init__.pyi: where type checkers find each public name."""
    lines = [
        f"from g1stream.{module} import {name} as {name}"
        for name, module in sorted(g1stream._HOME.items(), key=lambda item: (item[1], item[0]))
    ]
    version = "from g1stream._version import __version__ as __version__"
    head = "# Made by `make docs`."
    own = ("__all__: list[str]", "_HOME: dict[str, str]")
    return "\n".join([head, *sorted([*lines, version]), "", *own]) + "\n"


def _class(name: str, one: type) -> str:
    """A class with its fields, properties and methods."""
    record = issubclass(one, BaseModel)
    # Of other classes, the constructor is not for users.
    shown = is_dataclass(one) or issubclass(one, tuple) or "Args:\n" in (one.__doc__ or "")
    text = f"### {name}\n\n{_code(name, one) if shown else ''}{_text(one)}"
    if record:
        text += _fields(one)
    # Of a base that is not shown itself, the members are.
    bases = () if record else [base for base in one.__mro__[1:] if _is_hidden(base)]
    for key, member in (pair for base in (one, *bases) for pair in list(vars(base).items())):
        function = getattr(member, "fget", None) or getattr(member, "func", None)
        if key.startswith("_") or key == "model_config":
            continue
        if function:
            text += f"\n**`{name}.{key}`** -> `{_annotation(function)}`\n\n{_text(function)}"
        elif inspect.isroutine(member):
            function = getattr(member, "__func__", member)
            text += f"\n**`{name}.{key}`**\n\n{_code(key, function)}{_text(function)}"
    return text


def _is_hidden(base: type) -> bool:
    return base.__module__.startswith("g1stream.") and base.__name__ not in g1stream.__all__


def _nested(classes: list[tuple[str, type]]) -> dict[str, type]:
    """Records that are fields of exported records, and are not exported themselves."""
    found: dict[str, type] = {}
    pending = [one for _, one in classes if issubclass(one, BaseModel)]
    for record in pending:
        for field in record.model_fields.values():
            for kind in _types(field.annotation):
                if issubclass(kind, BaseModel) and kind not in pending:
                    pending.append(kind)
                    found[kind.__name__] = kind
    return found


def _types(hint: Any) -> list[type]:
    """The classes in a type hint."""
    if inspect.isclass(hint) and not hasattr(hint, "__args__"):
        return [hint]
    return [kind for inner in getattr(hint, "__args__", ()) for kind in _types(inner)]


def _fields(record: type[BaseModel]) -> str:
    """The fields with their types and, where they are settings, their defaults and meanings."""
    lines: list[str] = []
    for name, field in record.model_fields.items():
        extra: Any = field.json_schema_extra or {}
        line = f"- `{name}: {record.__annotations__.get(name, Any)}`"
        if field.description:
            unit = f" ({extra['unit']})" if extra.get("unit") else ""
            default = "" if field.is_required() else f", by default {field.default!r}"
            line += f"{default}: {field.description}{unit}"
        lines.append(line)
    return "\nFields:\n\n" + "\n".join(lines) + "\n" if lines else ""


def _annotation(function: Any) -> str:
    return str(function.__annotations__.get("return", "Any"))


def _code(name: str, one: Any) -> str:
    """The signature as a block of Python, a parameter a line where it is long."""
    signature = inspect.signature(one)
    parameters = [
        parameter.replace(
            annotation=_source(parameter.annotation), default=_default(parameter.default)
        )
        for key, parameter in signature.parameters.items()
        if key not in ("self", "cls", "_cls") and not key.startswith("_")
    ]
    returns = signature.empty if inspect.isclass(one) else _source(signature.return_annotation)
    text = str(inspect.Signature(parameters, return_annotation=returns))
    if len(text) > 80:
        shown = [str(parameter) for parameter in parameters]
        kinds = [parameter.kind for parameter in parameters]
        if inspect.Parameter.KEYWORD_ONLY in kinds:
            shown.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
        text = "(\n" + "".join(f"    {line},\n" for line in shown) + ")"
        text += f" -> {returns}" if returns is not signature.empty else ""
    return f"```python\n{name}{text}\n```\n\n"


def _source(annotation: Any) -> Any:
    """An annotation as it is written in the source."""
    text = getattr(annotation, "__forward_arg__", annotation)
    return _Source(text) if isinstance(text, str) else annotation


def _default(value: Any) -> Any:
    """A default whose text does not depend on the process."""
    plain = value is inspect.Parameter.empty or isinstance(
        value, (str, int, float, tuple, type(None))
    )
    return value if plain else _Source("...")


def _text(one: Any) -> str:
    """A docstring as Markdown: its sections become lists."""
    lines, section = [], ""
    for line in inspect.cleandoc(one.__doc__ or "").splitlines():
        if heading := _SECTION.fullmatch(line):
            section = heading[1]
            lines += [f"{section}:", ""]
        elif section and (entry := _ENTRY.match(line)):
            lines.append(f"- `{entry[1]}`: {entry[2]}")
        elif section in ("Returns", "Yields"):
            lines.append(line.strip())
        elif section:
            lines.append(f"  {line.strip()}" if line else "")
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PATH.write_text(api_docs())
    STUB.write_text(stub())
