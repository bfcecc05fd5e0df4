"""Packages and megabytes of `pip install g1stream`, and what each extra adds to them.

    python benchmarks/install_size.py

It follows the requirements of the packages that are installed beside g1stream, so it needs an
environment with the extras, such as that of `make test`. A size is that of the installed files,
without bytecode; of g1stream itself, which is installed from its checkout, it is 0. Extras that
are not installed are named, not measured.
"""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

NAME = "g1stream"
TOOLS = ("dev", "docs")


def needed(name: str, extras: frozenset[str] = frozenset()) -> set[str]:
    """Normalised names of a package and of all that it requires.

    Raises:
        PackageNotFoundError: one of them is not installed.
    """
    todo, seen = [(name, extras)], set[tuple[str, frozenset[str]]]()
    while todo:
        one = todo.pop()
        if one in seen:
            continue
        seen.add(one)
        environments = [{"extra": extra} for extra in (*one[1], "")]
        for text in distribution(one[0]).requires or ():
            required = Requirement(text)
            if not required.marker or any(map(required.marker.evaluate, environments)):
                todo.append((required.name, frozenset(required.extras)))
    return {re.sub(r"[-_.]+", "-", name).lower() for name, _ in seen}


def megabytes(name: str) -> float:
    """Size of a package's installed files, without bytecode."""
    files = [Path(str(one.locate())) for one in distribution(name).files or ()]
    return sum(one.stat().st_size for one in files if one.suffix != ".pyc" and one.is_file()) / 1e6


def main() -> None:
    core = needed(NAME)
    sizes = {name: megabytes(name) for name in core}
    largest = sorted(core, key=lambda name: -sizes[name])[:5]
    print(f"core: {len(core)} packages, {sum(sizes.values()):.0f} MB")
    print("  " + ", ".join(f"{name} {sizes[name]:.0f}" for name in largest))
    print(f"{'extra':<10}{'packages':>9}{'MB':>7}  largest")
    extras = distribution(NAME).metadata.get_all("Provides-Extra") or []
    for extra in sorted({*extras} - {*TOOLS}):
        try:
            added = {name: megabytes(name) for name in needed(NAME, frozenset({extra})) - core}
        except PackageNotFoundError as error:
            print(f"{extra:<10}  not installed: {error.name}")
            continue
        largest = sorted(added, key=lambda name: -added[name])[:3]
        shown = ", ".join(f"{name} {added[name]:.0f}" for name in largest)
        print(f"{extra:<10}{len(added):>9}{sum(added.values()):>7.0f}  {shown}")


if __name__ == "__main__":
    main()
