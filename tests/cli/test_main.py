import os
import subprocess
import sys

import pytest

from cli_help import check_help
from g1stream.cli.main import COMMANDS
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession


@pytest.mark.parametrize(
    ("arguments", "content", "named"),
    [
        ("motion {tmp}", "", "directory"),
        ("motion demo --robot {tmp}/no.urdf", "", "no.urdf"),
        ("stream demo --interface nowhere0", "", "no network interface 'nowhere0'"),
        ("stream demo --start 99", "", "99"),
        ("strem", "", "Choose from stream."),
        ("rollout", "", "Choose from library."),  # simulates them, says its purpose
        ("layuot", "", "Choose from layout."),
        ("stream demo --config {tmp}/no.toml", "", "no.toml"),
        ("sim --config {toml}", "[dds", "not valid TOML"),
        ("sim --config {toml}", "[sim]\nspeed = 2", "sim.speed"),
        ("sim --config {toml}", "[sim]\nrate = 'fast'", "sim.rate"),
        ("stream demo --gains {toml}", "[kp]\n'*_tail' = 3", "*_tail"),
        ("stream demo --gains {toml}", "[kp]\n'*' = 9000.0", "kp.* = 9000.0"),
        ("record -o {tmp}/no/session.mcap", "", "does not exist"),
    ],
)
def test_bad_input_is_explained(tmp_path, run, arguments, content, named):
    path = tmp_path / "config.toml"
    path.write_text(content)
    ended = run(*arguments.format(tmp=tmp_path, toml=path).split())
    assert (ended.code, ended.out) == (2, "")
    assert "error: " in ended.err
    assert named in ended.err


def test_a_directory_of_somebody_else_is_kept_even_from_force(tmp_path, domain_id, run):
    precious = tmp_path / "session.mcap" / "notes.txt"
    precious.parent.mkdir()
    precious.write_bytes(b"precious")
    ended = run("record", "-o", precious.parent, "--domain", domain_id, "--force")
    assert ended.code == 2
    assert str(precious.parent) in ended.err
    assert [*tmp_path.rglob("*.*")] == [precious.parent, precious]
    assert precious.read_bytes() == b"precious"


OF_CORE = [name for name, row in COMMANDS.items() if not row.extra]


@pytest.mark.parametrize("command", OF_CORE)
def test_help_has_examples_and_exit_codes_within_80_columns(command, monkeypatch, capsys):
    check_help(command, monkeypatch, capsys)


def test_an_error_is_wrapped_on_a_terminal_only(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    given = "info", "a name that is so long that it does not fit/session.mcap"
    cause, remedy = run(*given).err.splitlines()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    lines = run(*given).err.splitlines()
    assert max(map(len, lines)) <= 40
    assert " ".join(" ".join(lines).split()) == " ".join(f"{cause} {remedy}".split())


def test_the_list_of_commands_is_within_80_columns(run):
    lines = run("--help").out.splitlines()
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


def test_a_command_loads_no_window_library_with_mujoco():
    code = (
        "from g1stream.cli.main import main\n"
        "main(['--version'])\n"
        "import mujoco, sys\n"
        "print('glfw' in sys.modules)"
    )
    environment = {name: one for name, one in os.environ.items() if name != "MUJOCO_GL"}
    shown = subprocess.check_output([sys.executable, "-c", code], text=True, env=environment)
    assert shown.splitlines()[-1] == "False"


@pytest.mark.parametrize("command", ["doctor", "stream demo", "info"])
def test_without_cyclonedds_files_are_read_and_the_rest_says_how_to_install_it(command, tmp_path):
    """As where it is not installed, or where its library is another one."""
    stub = tmp_path / "stub" / "cyclonedds"
    stub.mkdir(parents=True)
    (stub / "__init__.py").write_text("raise ImportError('undefined symbol: dds_x')")
    words, reads = command.split(), command == "info"
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
def test_too_little_memory_is_no_traceback_and_a_defect_is_one(monkeypatch, run, error, told):
    def fail(_):
        raise error

    monkeypatch.setattr("g1stream.cli.main._run", fail)
    if told:
        assert "ulimit -v" in run().err
    else:
        with pytest.raises(type(error)):
            run()
