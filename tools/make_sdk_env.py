"""Make .sdk-venv, the environment in which the tests run Unitree's official SDKs.

The Python SDK pins cyclonedds 0.10.2, whose last wheels are for CPython 3.10, so this environment
is apart from the one g1stream runs in. A second run finds it made and returns at once.

Prints the path of its interpreter and exits with 0. Where the SDKs cannot run, prints why and exits
with 3; anything else that goes wrong is an error of its own.
"""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = ROOT / ".sdk-venv"
PYTHON = ENVIRONMENT / "bin" / "python"
MADE_FROM = ENVIRONMENT / "made-from.txt"
REQUIREMENTS = ROOT / "tests" / "integration" / "sdk_peers" / "requirements.txt"
IMPOSSIBLE = 3


def candidates() -> Iterator[Path]:
    """Where a CPython 3.10 may be: this one, on the PATH, in pyenv, in uv."""
    yield Path(sys.executable)
    on_path = shutil.which("python3.10")
    if on_path:
        yield Path(on_path)
    home = Path.home()
    pyenv = Path(os.environ.get("PYENV_ROOT") or home / ".pyenv")
    data = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    uv = Path(os.environ.get("UV_PYTHON_INSTALL_DIR") or data / "uv" / "python")
    yield from sorted((pyenv / "versions").glob("3.10.*/bin/python3.10"), reverse=True)
    yield from sorted(uv.glob("cpython-3.10.*/bin/python3.10"), reverse=True)


def is_cpython_310(interpreter: Path) -> bool:
    """Whether it runs, is CPython 3.10, and can make environments.

    A file of that name proves little: pyenv puts shims on the PATH that only print an error.
    """
    question = (
        "import sys, venv, ensurepip;"
        "sys.exit((sys.implementation.name, *sys.version_info[:2]) != ('cpython', 3, 10))"
    )
    try:
        answer = subprocess.run([interpreter, "-c", question], capture_output=True, check=False)
    except OSError:
        return False
    return answer.returncode == 0


def is_made() -> bool:
    """Whether the environment is whole, and made from these requirements."""
    same = MADE_FROM.exists() and MADE_FROM.read_text() == REQUIREMENTS.read_text()
    return same and PYTHON.exists()


def build(interpreter: Path) -> None:
    """Make the environment from nothing, with g1stream itself in it."""
    pip: list[str | Path] = [PYTHON, "-m", "pip", "--disable-pip-version-check"]
    install = [*pip, "install", "--quiet", "--no-deps"]
    steps: list[list[str | Path]] = [
        [interpreter, "-m", "venv", "--clear", ENVIRONMENT],
        [*install, "--upgrade", "pip>=24"],
        [*install, "--only-binary", ":all:", "--requirement", REQUIREMENTS],
        [*install, "--editable", ROOT],
    ]
    for step in steps:
        # Output goes to stderr, so that stdout has the one line that callers read.
        subprocess.run(step, stdout=sys.stderr, check=True)
    MADE_FROM.write_text(REQUIREMENTS.read_text())


def main() -> int:
    # Test processes that start together build it once.
    with REQUIREMENTS.open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not is_made():
            if (sys.platform, platform.machine()) != ("linux", "x86_64"):
                print("cyclonedds 0.10.2 and the SDKs have wheels for Linux on x86-64 alone")
                return IMPOSSIBLE
            interpreter = next(filter(is_cpython_310, candidates()), None)
            if interpreter is None:
                print("no CPython 3.10 on the PATH, in pyenv or in uv (`uv python install 3.10`)")
                return IMPOSSIBLE
            build(interpreter)
    print(PYTHON)
    return 0


if __name__ == "__main__":
    sys.exit(main())
