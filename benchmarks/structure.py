"""How large the package is, and how far each option reaches through its core.

    python benchmarks/structure.py [--source DIR] [--json]

The core is src/g1stream without extras/. Lines of code are lines with a token that is neither a
comment nor a docstring. A file knows an option if it has one of the option's words as a name or in
a string. `--source` counts another checkout, for a comparison.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import tokenize
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
#: Words of each option that could run through every room.
OPTIONS: Final = {
    "joints that play, kinds of G1": r"played|played_joints|others|joint_set|absent|present",
    "receiver": r"arm_sdk|ARM_SDK|onboard|motion_service|motion_switcher|via",
    "source: policy, balance": r"policy|feet|balance",
    "support": r"support|bolted|hanging",
    "clock of the robot": r"time_scale|RobotClock|robot_clock",
    "simulator or robot": r"profile|simulated|is_local_only",
    "recordings of others": r"attach|attached|recorded_motion|read_recording|open_log|read_bag",
    "foreign formats": r"gmr|sonic|beyondmimic|mjlab|holosoma|isaaclab|pickle|pickles",
    "parameters of a robot": r"params|parameters|Parameters",
}
_REFUSALS: Final = re.compile(r"has no effect|cannot be combined|have no effect")


def code_lines(text: str) -> int:
    """Lines with code: without comments, docstrings and blank lines."""
    skipped = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in skipped and token.type != tokenize.ENDMARKER
        for line in range(token.start[0], token.end[0] + 1)
    }
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and isinstance(body[0], ast.Expr):
            value = body[0].value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                lines -= set(range(value.lineno, (value.end_lineno or value.lineno) + 1))
    return len(lines)


def words_of(text: str) -> set[str]:
    """Names and words in strings, without comments and docstrings' sentences."""
    found: set[str] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME or (
            token.type == tokenize.STRING and '"""' not in token.string
        ):
            found |= set(re.findall(r"\w+", token.string))
    return found


def structure(root: Path = ROOT) -> dict[str, Any]:
    """The counts of a checkout."""
    package = root / "src" / "g1stream"
    files = sorted(package.rglob("*.py"))
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    core = [path for path in files if "extras" not in path.relative_to(package).parts]
    rooms = {"core": core, "extras": [path for path in files if path not in set(core)]}
    counted: dict[str, Any] = {
        name: {
            "files": len(paths),
            "lines": sum(texts[path].count("\n") for path in paths),
            "code": sum(code_lines(texts[path]) for path in paths),
        }
        for name, paths in rooms.items()
    }
    words = {path: words_of(texts[path]) for path in core}
    counted["core files that know an option"] = {
        option: sum(any(re.fullmatch(known, word) for word in words[path]) for path in core)
        for option, known in OPTIONS.items()
    }
    config = texts[package / "config.py"]
    settings = config[config.index("class DdsConfig") :]
    main = texts[package / "cli" / "main.py"]
    names = (package / "__init__.pyi").read_text(encoding="utf-8")
    counted["settings"] = len(re.findall(r"^    \w+: .* = setting\(", settings, re.MULTILINE))
    counted["commands"] = len(re.findall(r'"(?:cli|extras)\.[\w.]+:\w+"', main))
    counted["public names"] = len(re.findall(r"import \w+ as \w+", names))
    counted["refusals"] = sum(len(_REFUSALS.findall(text)) for text in texts.values())
    tests = [path.read_text(encoding="utf-8") for path in (root / "tests").rglob("*.py")]
    counted["tests"] = {"files": len(tests), "lines": sum(text.count("\n") for text in tests)}
    return counted


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--source", type=Path, default=ROOT, help="checkout to count")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    counted = structure(args.source)
    if args.json:
        print(json.dumps(counted, indent=2))
        return
    for name, value in counted.items():
        if isinstance(value, dict) and "files" not in value:
            print(name)
            for option, n in value.items():
                print(f"  {option:<32} {n:>6}")
        else:
            told = value if isinstance(value, dict) else {"": value}
            print(f"{name:<34} " + "  ".join(f"{n:>6} {unit}" for unit, n in told.items()))


if __name__ == "__main__":
    main()
