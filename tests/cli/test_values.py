"""Which flag is blamed for a value that is none: the one that has it, or none of them."""

from __future__ import annotations

import pytest

from g1stream.cli.values import reading
from g1stream.errors import ConfigError


def said_of(text, *arguments):
    """What is said of the first number among the arguments that cannot be read."""
    import tyro

    def command(domain: int = 1, interface: str = "lo", name: str = "") -> None:
        pass

    with pytest.raises(ConfigError) as caught, reading(arguments):
        tyro.cli(command, args=arguments)
    assert repr(text) in caught.value.cause
    assert caught.value.remedy == "Give a whole number."
    return caught.value.cause


@pytest.mark.parametrize(
    "arguments", [("--domain", "1x"), ("--domain=1x",), ("--interface", "lo", "--domain", "1x")]
)
def test_the_flag_is_named_that_has_the_value(arguments):
    assert said_of("1x", *arguments) == "The flag --domain cannot be '1x'."


@pytest.mark.parametrize(
    "arguments",
    [
        ("--interface", "1x", "--domain", "1x"),
        ("--interface=1x", "--domain", "1x"),
        ("--domain", "1x", "--name=1x"),
    ],
)
def test_no_flag_is_blamed_where_it_could_be_another(arguments):
    assert said_of("1x", *arguments) == "A flag has a value that it cannot have: '1x'."
