"""Optional parts: the packages that extras need, and functions of the extras."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = [
    "EXTENSIONS",
    "extension",
    "import_extra",
    "lazily",
    "load_object",
    "not_installed",
    "require_installed",
]

EXTENSIONS: Final = {
    "attach": "g1stream.extras.attach.attached:with_motion",
    "open_log": "g1stream.extras.attach.logs:open_log",
    "read_recording": "g1stream.extras.attach.recorded_motion:open_recorded",
    "live": "g1stream.extras.live.live:live",
    "motion_formats": "g1stream.extras.formats.table:FORMATS",
    "motion_service": "g1stream.extras.onboard.motion_service:MotionSwitcherClient",
    "simulated_service": "g1stream.extras.onboard.simulated:MotionService",
    "read_bag": "g1stream.extras.ros2.bag_reader:open_bag",
    "read_log": "g1stream.extras.ros2.bag_reader:BagSource",
    "write_bag": "g1stream.extras.ros2.bag_writer:write_ros2_bag",
    "motion_in_policy": "g1stream.extras.policy.held_motion:motion_in",
    "read_policy": "g1stream.extras.policy.held_motion:HeldMotion",
    "rehearse_policy": "g1stream.extras.policy.rehearsal:require_standing",
    "policy_terms": "g1stream.extras.policy.terms:encode",
    "policy_terms_schema": "g1stream.extras.policy.terms:schema",
    "write_motion": "g1stream.extras.formats.write:write_motion",
    "scene_meshes": "g1stream.extras.meshes.scene:SceneMeshes",
    "report": "g1stream.extras.report.page:report",
    "render": "g1stream.extras.video.render:render",
}
"""Functions, classes and tables of extras that the core calls, as `module:name`."""


def extension(name: str) -> Any:
    """Load a function of an extra.

    Args:
        name: key in `EXTENSIONS`.

    Raises:
        ConfigError: a package that the extra needs is not installed.
    """
    return load_object(EXTENSIONS[name])


def load_object(where: str, purpose: str = "") -> Any:
    """Load an object from a module, given as `module:name`; `purpose` as of `import_extra`.

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
        raise not_installed(package, extra, purpose or f"The extra `{extra}` needs") from error


def lazily(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a package whose names are loaded when they are first used.

    Args:
        package: name of the package.
        homes: module of each name, within the package.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return load_object(f"{package}.{homes[name]}:{name}")

    return load


def import_extra(package: str, extra: str, purpose: str) -> Any:
    """Import a package of an extra.

    Args:
        package: name of the package for `import`.
        extra: extra that the package belongs to.
        purpose: beginning of the error's sentence, such as `Tables need`.

    Raises:
        ConfigError: the package is not installed.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise not_installed(package, extra, purpose) from error


def require_installed(package: str, extra: str, purpose: str) -> None:
    """Check that a package which another process imports is installed, without importing it.

    Args:
        package: name of the package for `pip`.
        extra: extra that the package belongs to.
        purpose: as of `import_extra`.

    Raises:
        ConfigError: the package is not installed.
    """
    from importlib import metadata  # slow, and each process imports this module

    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        raise not_installed(package, extra, purpose) from None


def not_installed(package: str, extra: str, purpose: str) -> ConfigError:
    """The error for a missing package of an extra; arguments as of `import_extra`."""
    return ConfigError(
        f"{purpose} {package.replace('_', '-')}, which is not installed.",
        f"Install the extra: pip install 'g1stream[{extra}]'.",
    )
