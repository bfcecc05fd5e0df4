"""The packages of the extras, which may not be installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from g1stream.errors import ConfigError

__all__ = ["import_extra", "not_installed"]


def import_extra(package: str, extra: str, purpose: str) -> Any:
    """Import a package of an extra.

    Args:
        package: its name for `import`.
        extra: that it belongs to.
        purpose: what needs it, with the verb, such as `Tables need`.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise not_installed(package, extra, purpose) from error


def not_installed(package: str, extra: str, purpose: str) -> ConfigError:
    """What to raise where a package of an extra is absent; arguments as of `import_extra`."""
    return ConfigError(
        f"{purpose} {package.replace('_', '-')}, which is not installed.",
        f"Install the extra: pip install 'g1stream[{extra}]'.",
    )
