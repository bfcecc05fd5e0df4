"""Flags: how a command declares its own, and how those of its settings come from g1stream.config.

tyro parses the command line and shows the help; pydantic reads the values and checks them.
"""

from __future__ import annotations

import inspect
from contextlib import redirect_stdout
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from difflib import get_close_matches
from operator import getitem
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro
from annotated_types import Gt
from tyro.constructors import PrimitiveConstructorSpec

from g1stream.cli.help_text import KeptHelp, wrapped, wrapped_usage
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pydantic.fields import FieldInfo

__all__ = [
    "argument",
    "flag",
    "flag_name",
    "given_settings",
    "parse_flags",
]

CommandT = TypeVar("CommandT")


@dataclass(frozen=True, kw_only=True)
class _Option:
    """What a flag is, beside its name, type and default."""

    text: str
    metavar: str
    note: str
    limits: tuple[Any, ...] = ()
    required: bool = False
    positional: bool = False
    aliases: tuple[str, ...] = ()

    @classmethod
    def of(cls, setting: FieldInfo) -> _Option:
        """The flag of a setting."""
        from g1stream.settings import accepted

        about: Any = setting.json_schema_extra
        text, default = setting.description or "", setting.default
        if default is True:  # its flag is --no-NAME
            text = f"switch this off: {text}"
        notes = [] if _choices(setting.annotation) else [accepted(setting)]
        if default is not None and not isinstance(default, bool):
            notes.append(f"default: {_text(default)}")
        return cls(
            text=f"{text[0].upper()}{text[1:]}.",
            metavar=about["unit"].upper(),
            note="; ".join(filter(None, notes)),
            limits=tuple(setting.metadata),
        )

    def for_tyro(self, command: str, name: str, kind: Any) -> Any:
        """The type hint with which tyro shows it, and pydantic reads its value."""
        hint = f"({self.note})" if self.note else ""
        if kind is bool:
            return Annotated[bool, tyro.conf.arg(help=self.text, help_behavior_hint=hint)]
        shown = self.value_name(kind)
        if self.positional and not self.required:
            shown = f"[{shown}]"
        arg = tyro.conf.arg(
            metavar=shown, help=self.text, help_behavior_hint=hint, aliases=self.aliases or None
        )
        several = _is_several(kind) or get_origin(kind) is list

        def read(texts: list[str]) -> Any:
            if several:
                return get_origin(kind)(map(get_args(kind)[0], texts))
            plain = _kinds(kind)[0]
            if plain in (str, Path) and not self.limits:
                return plain(texts[0])  # `convert` starts without pydantic
            from pydantic import TypeAdapter, ValidationError

            limited: Any = getitem(Annotated, (kind, *self.limits)) if self.limits else kind
            try:
                return TypeAdapter(limited).validate_strings(texts[0])
            except ValidationError as error:
                wrong = error.errors()[0]["msg"]
                what = self.metavar if self.positional else f"The flag {flag_name(name)}"
                raise ConfigError(
                    f"{what} cannot be {texts[0]}: {wrong[0].lower()}{wrong[1:]}.",
                    f"`g1stream {command} --help` says what it accepts.",
                ) from None

        spec = PrimitiveConstructorSpec[Any](
            nargs="*" if several else 1,
            metavar="VALUE",
            instance_from_str=read,
            is_instance=lambda value: True,
            str_from_instance=lambda value: list(map(str, value)) if several else [str(value)],
        )
        marks = (tyro.conf.Positional,) if self.positional else ()
        # The type is for pydantic; tyro would load a type checker for it, which takes 60 ms.
        return getitem(Annotated, (object, *marks, arg, spec))

    def value_name(self, kind: Any) -> str:
        """What stands for its value in the help; empty where it has none."""
        if kind is bool:
            return ""
        choices = _choices(kind)
        return f"{{{','.join(choices)}}}" if choices else self.metavar or _metavar(kind)


def flag(
    default: Any,
    text: str,
    metavar: str = "",
    *,
    shown: str = "",
    positional: bool = False,
    gt: float | None = None,
    aliases: tuple[str, ...] = (),
) -> Any:
    """A flag of a command, as a field of its dataclass.

    Args:
        default: without the flag; MISSING for one that must be given.
        text: its help.
        metavar: what stands for its value in the help.
        shown: the default, in words where it needs some.
        positional: whether it is given by position, without its name.
        gt: the value must be greater than this.
        aliases: other names, such as `-o`.
    """
    if not shown and default not in (None, False, MISSING):
        shown = _text(default)
    required = default is MISSING
    option = _Option(
        text=text,
        metavar=metavar,
        note="required" if required else f"default: {shown}" if shown else "",
        limits=() if gt is None else (Gt(gt),),
        required=required,
        positional=positional,
        aliases=aliases,
    )
    return field(default=default, metadata={"option": option})


def argument(text: str, metavar: str) -> Any:
    """What must be given, by position."""
    return flag(MISSING, text, metavar, positional=True)


def flag_name(name: str) -> str:
    """A flag as the user writes it."""
    return f"--{name.replace('_', '-')}"


def parse_flags(
    kind: type[CommandT], name: str, purpose: str, arguments: Sequence[str]
) -> CommandT:
    """Make a command of its arguments; ends the process on --help.

    Args:
        kind: the command's class, a dataclass with a `flag` or an `argument` in each field. Its
            docstring is shown below the flags, its paragraphs wrapped. With a `config` it also
            gets a flag for each setting that has one on this command.
        name: as the user writes it.
        purpose: one sentence.
        arguments: what follows the name.

    Raises:
        ConfigError: a flag or an argument that does not exist or is missing, or a value that its
            flag does not accept.
    """
    hints, members = get_type_hints(kind), []
    own: Any = fields(kind)  # type: ignore[arg-type]  # mypy cannot say that it is a dataclass
    known, required = {"-h": "", "--help": ""}, []
    for one in own:
        option: _Option = one.metadata["option"]
        hint = option.for_tyro(name, one.name, hints[one.name])
        members.append((one.name, hint, field(default=one.default)))
        names = (flag_name(one.name), *option.aliases)
        if option.required:
            required.append(option.metavar if option.positional else names[-1])
        if not option.positional:
            known |= dict.fromkeys(names, option.value_name(hints[one.name]))
    if "config" in hints:
        members += _setting_fields(name)
        for _, setting_name, setting in _settings_of(name):
            flag = flag_name(f"no_{setting_name}" if setting.default is True else setting_name)
            known[flag] = _Option.of(setting).value_name(setting.annotation)
    # tyro prints its errors in a form of its own, so that they are found beside it.
    show_help = not {"-h", "--help"}.isdisjoint(arguments)
    if not show_help:
        _check_flags(name, arguments, known)
        several = [o.metadata["option"].positional for o in own if _is_several(hints[o.name])]
        if several == [True]:
            repeated = {flag_name(o.name) for o in own if get_origin(hints[o.name]) is list}
            arguments = _positionals_first(arguments, known, repeated)
    try:
        command: CommandT
        with redirect_stdout(KeptHelp()) as shown:
            command, extra = tyro.cli(
                make_dataclass(kind.__name__, members, bases=(kind,), frozen=True, kw_only=True),
                prog=f"g1stream {name}",
                description=purpose,
                args=arguments,
                return_unknown_args=True,
                console_outputs=show_help,
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
            )
    except SystemExit as done:
        if done.code:  # flags and their values are there
            raise _missing(name, required) from None
        usage, _, flags = shown.getvalue().partition("\n")
        print(wrapped_usage(usage), flags, sep="\n", end="")
        print(wrapped(inspect.cleandoc(kind.__doc__ or "")))  # tyro would join its lines
        raise
    if extra:
        raise ConfigError(
            f"The argument {extra[0]} is one too many for g1stream {name}.",
            f"Leave it out; `g1stream {name} --help` shows the arguments.",
        )
    if () in (getattr(command, one.name) for one in own if one.metadata["option"].required):
        raise _missing(name, required)
    return command


def _missing(command: str, required: Sequence[str]) -> ConfigError:
    names = " or ".join(name.removesuffix("...") for name in required)
    return ConfigError(
        f"The argument {names} is missing.",
        f"Add it; `g1stream {command} --help` says what it is.",
    )


def _check_flags(command: str, arguments: Sequence[str], known: Mapping[str, str]) -> None:
    """Refuse flags that do not exist, and those that lack their value.

    Args:
        command: as the user writes it.
        arguments: what follows it.
        known: its flags, each with what stands for its value in the help, if it has one.
    """
    end = arguments.index("--") if "--" in arguments else len(arguments)
    following = [*arguments[1:end], "--"]
    for text, after in zip(arguments, following, strict=False):
        name, equals, _ = text.partition("=")
        flag = name.replace("_", "-")
        if not _is_flag(flag):
            continue
        if flag not in known and flag[:2] not in known:
            close = get_close_matches(flag, known, 1)
            instead = f"Use {close[0]}, or another" if close else "Choose"
            raise ConfigError(
                f"g1stream {command} has no flag {name}.",
                f"{instead} one that `g1stream {command} --help` shows.",
            )
        if known.get(flag) and not equals and _is_flag(after):
            meant = after != "--" and after.partition("=")[0] not in known
            equals = f"; one that begins with a minus as {flag}={after!r}" * meant
            raise ConfigError(
                f"The flag {flag} lacks its value.", f"Add it: {flag} {known[flag]}{equals}."
            )


def _positionals_first(
    arguments: Sequence[str], known: Mapping[str, str], repeated: Collection[str]
) -> list[str]:
    """The same arguments, those given by position before the flags, repeated flags as one.

    tyro takes arguments of any number from one place only.

    Args:
        arguments: what follows the command.
        known: its flags, each with what stands for its value in the help, if it has one.
        repeated: those of them that may be given several times.
    """
    values: dict[str, list[str]] = {name: [] for name in repeated}
    positional: list[str] = []
    flags: list[str] = []
    left = iter(arguments)
    for text in left:
        if text == "--":
            return [*flags, text, *positional, *left]
        if not _is_flag(text):
            positional.append(text)
            continue
        name, equals, value = text.partition("=")
        if name in values:
            values[name].append(value if equals else next(left))
            continue
        flags.append(text)
        if not equals and known.get(text.replace("_", "-")):
            flags.append(next(left))
    flags += [text for name, given in values.items() if given for text in (name, *given)]
    return [*positional, *flags]


def _is_several(hint: Any) -> bool:
    """Whether a flag or an argument takes any number of values."""
    return get_origin(hint) is tuple


def _is_flag(text: str) -> bool:
    """Whether it looks like a flag; a negative number does not."""
    return text.startswith("-") and (text[1:2].isalpha() or text.startswith("--"))


def given_settings(command: object) -> dict[str, Any]:
    """The settings among the flags that were given, keyed like `stream.rate`."""
    from g1stream.config import settings

    given = {}
    for key, setting in settings().items():
        table, _, name = key.rpartition(".")
        unset = _unset(setting)
        value = getattr(getattr(command, _group(table), None) if table else command, name, unset)
        if value is not unset:  # by identity: 0 is a domain, and equal to False
            given[key] = value
    return given


def _settings_of(command: str) -> Iterator[tuple[str, str, FieldInfo]]:
    """Table, name and declaration of each setting with a flag on a command."""
    from g1stream.config import settings

    for key, setting in settings().items():
        about: Any = setting.json_schema_extra or {}
        if command in about.get("flag", ()):
            table, _, name = key.rpartition(".")
            yield table, name, setting


def _setting_fields(command: str) -> list[Any]:
    """The settings with a flag on a command, as fields: None, or False, where not given."""
    from g1stream.config import Config

    tables: dict[str, list[Any]] = {}
    for table, name, setting in _settings_of(command):
        hint = _Option.of(setting).for_tyro(command, name, setting.annotation)
        tables.setdefault(table, []).append((name, hint, field(default=_unset(setting))))
    fields = tables.pop("", [])
    for table, flags in tables.items():
        text = {"__doc__": Config.model_fields[table].annotation.__doc__}
        group: Any = make_dataclass(table, flags, frozen=True, kw_only=True, namespace=text)
        hint = Annotated[group, tyro.conf.arg(name=table)]
        fields.append((_group(table), hint, field(default_factory=group)))
    return fields


def _unset(setting: FieldInfo) -> Any:
    """The value of a setting's flag that is not given; --NAME or --no-NAME changes a bool's."""
    return setting.default if setting.annotation is bool else None


def _group(table: str) -> str:
    """The field of a command with its settings of a table; `record` alone is a flag."""
    return f"{table}_settings"


def _kinds(hint: Any) -> tuple[Any, ...]:
    """The types in a hint, without Optional."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _choices(hint: Any) -> tuple[Any, ...]:
    return next((get_args(one) for one in _kinds(hint) if get_origin(one) is Literal), ())


def _text(default: Any) -> str:
    return f"{default:g}" if isinstance(default, float) else str(default)


def _metavar(hint: Any) -> str:
    return {int: "N", Path: "FILE"}.get(_kinds(hint)[0], "NAME")
