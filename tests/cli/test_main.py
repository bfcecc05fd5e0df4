"""What a user can get wrong ends with a cause, a remedy and exit code 2, never with a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cli_help import check_help
from g1stream.cli.main import COMMANDS, main
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession

DEMO = Path(__file__).parents[2] / "src" / "g1stream" / "motion" / "demo.csv"


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "g1stream", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def changed(tmp_path: Path, old: str, new: str) -> Path:
    path = tmp_path / "changed.csv"
    text = DEMO.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def toml(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "config.toml"
    path.write_text(text)
    return path


CASES = {
    "a directory": (lambda tmp: ["motion", tmp], "directory"),
    "a joint nobody knows": (
        lambda tmp: ["motion", changed(tmp, "left_knee_joint", "left_kneee_joint")],
        "left_kneee_joint",
    ),
    "text for a number": (lambda tmp: ["motion", changed(tmp, "\n1,", "\n1,oops")], "line 3"),
    "a repeated frame": (lambda tmp: ["motion", changed(tmp, "\n2,", "\n1,")], "line 4"),
    "no such URDF": (lambda tmp: ["motion", "demo", "--robot", tmp / "no.urdf"], "no.urdf"),
    "no such interface": (
        lambda tmp: ["stream", "demo", "--interface", "nowhere0"],
        "no network interface 'nowhere0'",
    ),
    "a start beyond the end": (lambda tmp: ["stream", "demo", "--start", 99], "99"),
    "no such command": (lambda tmp: ["strem"], "stream"),
    "no such config": (lambda tmp: ["stream", "demo", "--config", tmp / "no.toml"], "no.toml"),
    "not TOML": (lambda tmp: ["sim", "--config", toml(tmp, "[dds")], "not valid TOML"),
    "no such setting": (
        lambda tmp: ["sim", "--config", toml(tmp, "[sim]\nspeed = 2")],
        "sim.speed",
    ),
    "a setting of the wrong type": (
        lambda tmp: ["sim", "--config", toml(tmp, "[sim]\nrate = 'fast'")],
        "sim.rate",
    ),
    "gains for no joint": (
        lambda tmp: ["stream", "demo", "--gains", toml(tmp, "[kp]\n'*_tail' = 3")],
        "*_tail",
    ),
    "a gain beyond any": (
        lambda tmp: ["stream", "demo", "--gains", toml(tmp, "[kp]\n'*' = 9000.0")],
        "kp.* = 9000.0",
    ),
    "a misspelt joint": (
        lambda tmp: ["stream", "demo", "--gains", toml(tmp, "[kp]\nleft_kne_joint = 3.0")],
        "left_kne_joint",
    ),
    "a recording in no directory": (
        lambda tmp: ["record", tmp / "no" / "session.mcap"],
        "does not exist",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_explained(tmp_path, case, capsys):
    arguments, named = CASES[case]
    assert main([*map(str, arguments(tmp_path))]) == 2
    printed = capsys.readouterr()
    assert "error: " in printed.err
    assert named in printed.err
    assert not printed.out


def test_a_directory_of_somebody_else_is_kept_even_from_force(tmp_path, domain_id, capsys):
    precious = tmp_path / "session" / "notes.txt"
    precious.parent.mkdir()
    precious.write_bytes(b"precious")
    command = ("record", tmp_path / "session.mcap", "--domain", domain_id)
    assert main([*map(str, command), "--split-duration=60", "--force"]) == 2
    assert str(precious.parent) in capsys.readouterr().err
    assert [*tmp_path.rglob("*.*")] == [precious]
    assert precious.read_bytes() == b"precious"


OF_CORE = [name for name, row in COMMANDS.items() if not row.home.startswith("extras.")]


@pytest.mark.slow
@pytest.mark.parametrize("command", OF_CORE)
def test_help_has_examples_and_exit_codes_within_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    check_help(command, run(command, "--help"))
    check_help(command, run(command, "--help-all"))


def test_an_error_is_wrapped_on_a_terminal_only(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    given = ["info", "a name that is so long that it does not fit/session.mcap"]
    assert main(given) == 2
    cause, remedy = capsys.readouterr().err.splitlines()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(given) == 2
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 40
    assert " ".join(" ".join(lines).split()) == " ".join(f"{cause} {remedy}".split())


def test_the_list_of_commands_is_within_80_columns():
    lines = run("--help").stdout.splitlines()
    listed = [line.split()[0] for line in lines if line.startswith("  ")]
    assert listed[: len(COMMANDS)] == list(COMMANDS)
    assert max(map(len, lines)) <= 80


def test_help_needs_no_heavy_imports():
    heavy = ("mujoco", "scipy", "cyclonedds", "matplotlib", "mcap", "numpy", "pydantic")
    code = (
        "import sys, contextlib, io\n"
        "from g1stream.cli.main import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "    main(['--help'])\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", ["doctor", "stream demo", "info", "plot"])
def test_without_cyclonedds_files_are_read_and_the_rest_says_how_to_install_it(command, tmp_path):
    """As where it is not installed, or where its library is another one."""
    stub = tmp_path / "stub" / "cyclonedds"
    stub.mkdir(parents=True)
    (stub / "__init__.py").write_text("raise ImportError('undefined symbol: dds_x')")
    words, reads = command.split(), command in ("info", "plot")
    if reads:
        with SessionWriter(tmp_path / "s.mcap") as writer:
            SyntheticSession(1.0).write(writer)
        words.append("s.mcap")
    path = os.pathsep.join([str(stub.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "g1stream", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert done.returncode == (0 if reads else 2), done.stderr
    assert ("pip install 'cyclonedds" in done.stderr) == (not reads)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (MemoryError(), True),
        (ImportError("libx.so: failed to map segment from shared object"), True),
        (ModuleNotFoundError("No module named 'x'"), False),
        (ZeroDivisionError(), False),
    ],
)
def test_too_little_memory_is_no_traceback_and_a_defect_is_one(monkeypatch, capsys, error, told):
    def fail(_):
        raise error

    monkeypatch.setattr("g1stream.cli.main._run", fail)
    if told:
        assert main([]) == 2
        assert "ulimit -v" in capsys.readouterr().err
    else:
        with pytest.raises(type(error)):
            main([])
