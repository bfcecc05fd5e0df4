import shutil
import subprocess

import pytest

from g1stream.cli.flags import command_parser
from g1stream.cli.main import COMMANDS, load_command, main

SHELLS = ("bash", "zsh", "fish")
#: What is typed, and what is offered for its last word; files.
TYPED = {
    "g1stream str": ({"stream"}, False),
    "g1stream stream --dur": ({"--duration"}, False),
    "g1stream stream demo --feedfor": ({"--feedforward"}, False),  # one of --help-all
    "g1stream stream demo --support fe": ({"feet"}, False),
    "g1stream demo --support ": ({"bolted", "hanging", "follow", "free", "feet"}, False),
    "g1stream completion ": (set(SHELLS), False),
    "g1stream stream dan": (set(), True),
    "g1stream info dan": (set(), True),
    "g1stream stream demo --record dan": (set(), True),
}
# What readline does with the words before the cursor.
BASH = """
source "$1"
COMP_LINE="$2"; COMP_POINT=${#2}; COMP_CWORD=-1
read -ra COMP_WORDS <<< "$2"; [[ "$2" == *" " ]] && COMP_WORDS+=("")
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
complete=($(complete -p g1stream)); function=""
for ((i = 0; i < ${#complete[@]}; i++)); do
  [[ ${complete[i]} == -F ]] && function=${complete[i + 1]}
done
$function g1stream "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}" 2> /dev/null
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    directory = tmp_path_factory.mktemp("completion")
    for shell in SHELLS:
        with (directory / shell).open("w") as file, pytest.MonkeyPatch.context() as patched:
            patched.setattr("sys.stdout", file)
            assert main(["completion", shell]) == 0
    return directory


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_flag_is_known(scripts, shell):
    text = (scripts / shell).read_text()
    for name, row in COMMANDS.items():
        if row.home.startswith("extras."):
            continue  # it may be hidden
        assert name in text
        for action in command_parser(load_command(name), name, row.purpose)._actions:
            for option in action.option_strings:
                assert option.lstrip("-") in text


@pytest.mark.parametrize("typed", TYPED)
def test_bash_completes(scripts, tmp_path, typed):
    (tmp_path / "dance.csv").touch()
    offered = subprocess.run(
        ["bash", "-c", BASH, "bash", scripts / "bash", typed],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    ).stdout.split()
    words, file = TYPED[typed]
    assert set(offered) == (words | ({"dance.csv"} if file else set()))


@pytest.mark.parametrize("shell", SHELLS)
def test_the_syntax_is_right(scripts, shell):
    if not shutil.which(shell):
        pytest.skip(f"{shell} is not installed")
    subprocess.run([shell, "-n", scripts / shell], check=True)
    for typed in ("g1stream str", "g1stream stream demo --support fe") if shell == "fish" else ():
        code = f'source {scripts / "fish"}; complete --do-complete "{typed}"'
        done = subprocess.run(["fish", "-c", code], capture_output=True, text=True, check=True)
        assert {line.split("\t")[0] for line in done.stdout.splitlines()} == TYPED[typed][0]
