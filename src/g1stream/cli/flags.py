"""Flags: a command's dataclass fields, and the settings that have a flag on the command.

argparse parses the command line and writes the help; pydantic checks the values.
"""

from __future__ import annotations

import inspect
import re
import shutil
import textwrap
from argparse import SUPPRESS, ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import get_close_matches
from fnmatch import fnmatch
from operator import getitem
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NoReturn,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Gt

from g1stream.errors import ConfigError
from g1stream.text import counted

if TYPE_CHECKING:
    from argparse import _ActionsContainer
    from collections.abc import Callable, Sequence

    from pydantic.fields import FieldInfo

CommandT = TypeVar("CommandT")

#: Least similarity of the name in a hint: --output and --out have 0.667, --topics and --to 0.5.
_SIMILAR = 0.66
#: Units that do not explain a value by themselves.
_UNITS = {"s": "SECONDS", "m": "METERS"}


@dataclass(frozen=True, kw_only=True)
class _Option:
    """The help text and restrictions of a flag."""

    text: str
    metavar: str = ""
    note: str = ""
    limits: tuple[Any, ...] = ()
    positional: bool = False
    aliases: tuple[str, ...] = ()
    switches_off: bool = False
    advanced: bool = False
    needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()


def flag(
    default: Any,
    text: str,
    metavar: str = "",
    *,
    shown: str = "",
    positional: bool = False,
    gt: float | None = None,
    aliases: tuple[str, ...] = (),
    advanced: bool = False,
    needs: tuple[str, ...] = (),
    excludes: tuple[str, ...] = (),
) -> Any:
    """A flag of a command, as a field of its dataclass. The default MISSING makes it required.

    `metavar` stands for the value in the help, and `shown` for the default. A `positional` flag is
    given without its name. The value must be greater than `gt`. `aliases` are names such as `-q`;
    a flag `out` is also `-o`. Only --help-all shows an `advanced` flag.

    The flag is refused with one of `excludes`, and unless it finds one of `needs`: a flag or a
    setting by its key, or KEY=PATTERN for the value of an argument, of several the output, which
    is --out or the last. A command without KEY does not need it. What a flag needs is declared
    before the flag.
    """
    if not shown and default not in (None, False, MISSING):
        shown = _text(default)
    option = _Option(
        text=text,
        metavar=metavar,
        note="required" if default is MISSING else f"default: {shown}" if shown else "",
        limits=() if gt is None else (Gt(gt),),
        positional=positional,
        aliases=aliases,
        advanced=advanced,
        needs=needs,
        excludes=excludes,
    )
    return field(default=default, metadata={"option": option})


def argument(text: str, metavar: str) -> Any:
    """A required positional argument."""
    return flag(MISSING, text, metavar, positional=True)


def flag_name(name: str) -> str:
    """A flag as the user writes it."""
    return f"--{name.replace('_', '-')}"


def lacking(shown: str, needs: str) -> ConfigError:
    """The error for a flag without what it needs."""
    return ConfigError(f"{shown} needs {needs}.", f"Give {needs}, or remove {shown}.")


def parse_flags(
    kind: type[CommandT], name: str, purpose: str, arguments: Sequence[str]
) -> CommandT:
    """Make a command from its arguments. It ends the process on --help and --help-all.

    The class `kind` is a dataclass with a `flag` or an `argument` in each field. The help shows its
    docstring below the flags, with wrapped paragraphs. A class with the field `settings` also gets
    a flag for each setting that has one on this command. The field then holds the settings that
    were given, keyed like `stream.rate`. `kind.defaults` describes, by such keys, the settings
    whose default the command itself chooses.

    Raises:
        ConfigError: a flag or an argument is unknown or missing, or a flag does not accept its
            value, lacks what it needs, or excludes another one.
    """
    parser, settings, hints = _parser_of(kind, name, purpose, everything="--help-all" in arguments)
    given = parser.parse(arguments)
    chosen = {key: given.pop(key) for key in settings if key in given}
    values = {
        key: tuple(value) if get_origin(hints[key]) is tuple else value
        for key, value in given.items()
    }
    return kind(**values, **({"settings": chosen} if "settings" in hints else {}))


def _parser_of(
    kind: type[Any], name: str, purpose: str, *, everything: bool
) -> tuple[_Parser, dict[str, FieldInfo], dict[str, Any]]:
    """The parser of a command, its settings, and the types of its fields."""
    hints = get_type_hints(kind)
    own: list[Field[Any]] = [one for one in fields(kind) if "option" in one.metadata]
    parser = _Parser(name, purpose, inspect.cleandoc(kind.__doc__ or ""), everything=everything)
    for one in own:
        parser.add_flag(parser, one.name, one.metadata["option"], hints[one.name], one.default)
    settings = _settings_of(name) if "settings" in hints else {}
    defaults = getattr(kind, "defaults", {})
    for table in dict.fromkeys(key.rpartition(".")[0] for key in settings):
        # The tables of a TOML file only interest users who want to see all flags.
        group = parser.add_argument_group(f"[{table}]") if table and everything else parser
        for key, setting in settings.items():
            if key.rpartition(".")[0] == table:
                option = _option_of(setting, defaults.get(key, ""))
                parser.add_flag(group, key, option, setting.annotation)
    parser.complete(tables=any("." in key for key in settings))
    return parser, settings, hints


def command_parser(kind: type[Any], name: str, purpose: str) -> ArgumentParser:
    """A parser that knows all flags of a command, for man pages."""
    return _parser_of(kind, name, purpose, everything=True)[0]


class _Parser(ArgumentParser):
    """The parser of one command. It raises a `ConfigError` for bad arguments."""

    def __init__(self, command: str, purpose: str, epilog: str, *, everything: bool) -> None:
        width = min(80, shutil.get_terminal_size().columns)
        super().__init__(
            prog=f"g1stream {command}",
            description=textwrap.fill(purpose, width),
            # Paragraphs with indented lines, such as the examples, are not wrapped.
            epilog="\n\n".join(
                paragraph if "\n " in paragraph else textwrap.fill(paragraph, width)
                for paragraph in epilog.split("\n\n")
            ),
            formatter_class=lambda prog: RawDescriptionHelpFormatter(
                prog, max_help_position=22, width=width
            ),
            allow_abbrev=False,
            argument_default=SUPPRESS,
        )
        self._command, self._everything = command, everything
        self._options: dict[str, _Option] = {}
        self._known = ["-h", "--help", "--help-all"]
        self._advanced = 0
        self._usage = [f"g1stream {command} [-h] [OPTIONS]"]

    def add_flag(
        self, group: _ActionsContainer, key: str, option: _Option, kind: Any, default: Any = None
    ) -> None:
        """Add a flag, or a positional argument, with the type of its value.

        The default MISSING makes it required. Only a positional argument needs another one here,
        because argparse cannot leave it unset.
        """
        self._options[key], required = option, default is MISSING
        needs = self._needs(key)
        notes = "; ".join(filter(None, (needs and f"needs {needs}", option.note)))
        text = f"{option.text} ({notes})" if notes else option.text
        about: dict[str, Any] = {"help": text.replace("%", "%%")}
        self._advanced += option.advanced
        if option.advanced and not self._everything:
            about["help"] = SUPPRESS
        names = [self._shown(key), *option.aliases, *["-o"] * (key == "out")]
        if kind is bool:
            about["action"] = "store_false" if option.switches_off else "store_true"
        else:
            choices = _choices(kind)
            metavar = f"{{{','.join(choices)}}}" if choices else option.metavar or _metavar(kind)
            about["metavar"] = metavar
            shown = names[0] if option.positional else f"The flag {names[0]}"
            about["type"] = self._reader(shown, kind, option.limits)
            about["action"] = "append" if get_origin(kind) is list else "store"
            if get_origin(kind) is tuple:
                about["nargs"] = "*" if option.positional and not required else "+"
            elif option.positional and not required:
                about["nargs"] = "?"
        if option.positional:
            group.add_argument(key, default=default, **about)
            self._usage.append(metavar if required else f"[{metavar}]")
            return
        if required:
            self._usage.append(f"{names[-1]} {metavar}")
            about["required"] = True
        if "nargs" in about:  # argparse itself shows that the value may be repeated
            about["metavar"] = metavar.removesuffix("...")
        self._known += names
        group.add_argument(*names, dest=key, **about)

    def _reader(self, shown: str, kind: Any, limits: tuple[Any, ...]) -> Callable[[str], Any]:
        """A function that converts the text of an argument to its value."""
        if get_origin(kind) in (tuple, list):
            kind = get_args(kind)[0]
        plain = _kinds(kind)[0]
        if plain in (str, Path) and not limits:
            return plain  # type: ignore[no-any-return]  # `convert` starts without pydantic

        def read(text: str) -> Any:
            from pydantic import ConfigDict, TypeAdapter, ValidationError

            limited: Any = getitem(Annotated, (kind, *limits)) if limits else kind
            adapter: Any = TypeAdapter(limited, config=ConfigDict(allow_inf_nan=False))
            try:
                return adapter.validate_strings(text)
            except ValidationError as error:
                wrong = error.errors()[0]["msg"]
                raise ConfigError(
                    f"{shown} cannot be {text}: {wrong[0].lower()}{wrong[1:]}.", self._see_help()
                ) from None

        return read

    def complete(self, *, tables: bool) -> None:
        """Write the usage, and add --help-all if there are advanced flags.

        `tables` is whether it shows settings in the tables of a TOML file.
        """
        indent = " " * len("usage: ")
        usage = textwrap.fill(
            " ".join(self._usage),
            80,
            initial_indent=indent,
            subsequent_indent=indent,
            break_on_hyphens=False,
        )
        self.usage = usage.lstrip()
        if self._advanced or self._everything:
            which = "all flags" if self._everything else counted(self._advanced, "more flag")
            more = ", and the TOML table of each setting" if tables else ""
            self.add_argument("--help-all", action="help", help=f"Show {which}{more}.")

    def _shown(self, key: str) -> str:
        """The flag or argument as the user writes it."""
        option, name = self._options[key], key.rpartition(".")[2]
        if option.positional:
            return option.metavar
        return flag_name(f"no_{name}" if option.switches_off else name)

    def _needs(self, key: str) -> str:
        """What a flag needs, as the user writes it; empty if nothing."""
        needs = [need.partition("=") for need in self._options[key].needs]
        shown = [(self._shown(key), value) for key, _, value in needs if key in self._options]
        return " or ".join(f"{name.split()[-1]} {value}".rstrip() for name, value in shown)

    def _check(self, given: dict[str, Any]) -> None:
        """Refuse a flag without what it needs, or with one that it excludes."""

        def is_given(need: str) -> bool:
            key, _, pattern = need.partition("=")
            value = given.get(key)
            last = given.get("out", value[-1]) if isinstance(value, list) else value
            # A file of settings may have what a flag needs, see `SettingsCommand.resolve`.
            named = key in given or ("." in key and "config" in given)
            return named and fnmatch(str(last).lower(), pattern or "*")

        for key in given:
            shown, needs = self._shown(key), self._needs(key)
            if needs and not any(map(is_given, self._options[key].needs)):
                raise lacking(shown, needs)
            for other in filter(given.__contains__, self._options[key].excludes):
                both = f"{shown} cannot be combined with {self._shown(other)}."
                raise ConfigError(both, "Remove one of them.")

    def parse(self, arguments: Sequence[str]) -> dict[str, Any]:
        """The values that were given, by the key of `add_flag`."""
        end = arguments.index("--") if "--" in arguments else len(arguments)
        texts = list(arguments)
        for i, text in enumerate(texts[:end]):
            name, equals, value = text.partition("=")
            if re.match(r"--|-[a-zA-Z]", name):
                flag = name.replace("_", "-")
                texts[i] = f"{flag}{equals}{value}"
                if flag not in self._known and flag[:2] not in self._known:
                    cause = f"g1stream {self._command} has no flag {name}."
                    raise ConfigError(cause, f"{self._nearest(flag)}{self._see_help()}")
        namespace, extra = self.parse_known_intermixed_args(texts)
        if extra:
            raise ConfigError(
                f"g1stream {self._command} has no use for the argument {extra[0]}.",
                f"Remove it; {self._see_help()}",
            )
        given = {key: value for key, value in vars(namespace).items() if value not in (None, ())}
        self._check(given)
        return given

    def _nearest(self, flag: str) -> str:
        """A hint at the known flag with the most similar name, unless it has the opposite sense."""
        off = flag.startswith("--no-")
        long = [known for known in self._known if known.startswith("--")]
        names = [known[2:] for known in long if known.startswith("--no-") == off]
        close = get_close_matches(flag[2:], names, 1, _SIMILAR)
        return f"The most similar flag is --{close[0]}; " if close else ""

    def error(self, message: str) -> NoReturn:
        """Raise a ConfigError for argparse's error, such as a missing value."""
        cause = re.sub("^argument ", "flag ", message)
        raise ConfigError(f"{cause[0].upper()}{cause[1:]}.", self._see_help())

    def _see_help(self) -> str:
        shown = "--help-all" if self._advanced else "--help"
        return f"`g1stream {self._command} {shown}` lists what it accepts."


def _settings_of(command: str) -> dict[str, FieldInfo]:
    """The settings with a flag on a command, by name, such as `stream.rate`."""
    from g1stream.config import settings

    found = {}
    for key, setting in settings().items():
        about: Any = setting.json_schema_extra or {}
        if command in about.get("flag", ()):
            found[key] = setting
    return found


def _option_of(setting: FieldInfo, shown: str) -> _Option:
    """The flag of a setting; `shown` stands for the default in the help, unless it is ""."""
    from g1stream.config import accepted

    about: Any = setting.json_schema_extra
    text, default = setting.description or "", setting.default
    if default is True:
        text = f"Switch this off: {text}"
    notes = [] if _choices(setting.annotation) else [accepted(setting)]
    if shown or (default is not None and not isinstance(default, bool)):
        notes.append(f"default: {shown or _text(default)}")
    return _Option(
        text=f"{text[0].upper()}{text[1:]}.",
        metavar=about["metavar"] or _UNITS.get(about["unit"], about["unit"].upper()),
        note="; ".join(filter(None, notes)),
        limits=tuple(setting.metadata),
        switches_off=default is True,
        advanced=about["advanced"],
        needs=about["needs"],
    )


def _kinds(hint: Any) -> tuple[Any, ...]:
    """The types in a type hint, without Optional."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _text(default: Any) -> str:
    return f"{default:g}" if isinstance(default, float) else str(default)


def _choices(hint: Any) -> tuple[str, ...]:
    return next((get_args(one) for one in _kinds(hint) if get_origin(one) is Literal), ())


def _metavar(hint: Any) -> str:
    return {int: "N", float: "NUMBER", Path: "FILE"}.get(_kinds(hint)[0], "NAME")
