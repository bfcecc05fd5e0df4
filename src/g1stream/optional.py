"""What may not be installed: the packages of the extras, and the extras' own programs."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

from g1stream.errors import ConfigError

__all__ = [
    "EXTENSIONS",
    "extension",
    "import_extra",
    "load_object",
    "not_installed",
    "require_installed",
]

EXTENSIONS: Final = {
    "read_bag": "g1stream.extras.ros2.bag_reader:open_bag",
    "read_log": "g1stream.extras.ros2.bag_reader:BagSource",
    "write_bag": "g1stream.extras.ros2.bag_writer:write_ros2_bag",
    "read_policy": "g1stream.extras.policy.held_motion:HeldMotion",
    "render": "g1stream.extras.video.render:render",
}
"""Functions of extras that the core calls: module and name."""


def extension(name: str) -> Any:
    """A function of an extra.

    Args:
        name: in `EXTENSIONS`.

    Raises:
        ConfigError: a package that the extra needs is not installed.
    """
    return load_object(EXTENSIONS[name])


def load_object(where: str) -> Any:
    """What is in a module: `module:name`.

    Raises:
        ConfigError: a package that the extra needs is not installed.
    """
    module, _, name = where.partition(":")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if not module.startswith("g1stream.extras."):
            raise
        package, extra = error.name or "", module.split(".")[2]
        raise not_installed(package, extra, f"The extra `{extra}` needs") from error


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


def require_installed(package: str, extra: str, purpose: str) -> None:
    """Check for a package that another process shall import, without loading it into this one.

    Args:
        package: its name for `pip`.
        extra: that it belongs to.
        purpose: as of `import_extra`.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        version(package)
    except PackageNotFoundError:
        raise not_installed(package, extra, purpose) from None


def not_installed(package: str, extra: str, purpose: str) -> ConfigError:
    """What to raise where a package of an extra is absent; arguments as of `import_extra`."""
    return ConfigError(
        f"{purpose} {package.replace('_', '-')}, which is not installed.",
        f"Install the extra: pip install 'g1stream[{extra}]'.",
    )
