from math import nan

import pytest

from g1stream.cli.main import main
from g1stream.errors import ConfigError
from g1stream.extras.report.comparison import CONDITION_NAMES
from g1stream.extras.report.fail_if import FailIf

NAMES = ("rmse", "delay", "success")


def parse(text):
    return FailIf.parse(text, NAMES, with_base=NAMES[:2])


@pytest.mark.parametrize(
    ("text", "value", "base", "holds"),
    [
        ("rmse > 0.02", 0.03, None, True),
        ("rmse >= 2e-2", 0.02, None, True),
        (" rmse<=0.02 ", 0.02, None, True),
        ("delay < -0.01", -0.02, None, True),
        ("rmse > 1.5 * base", 0.031, 0.02, True),
        ("rmse > 1.5*base", 0.029, 0.02, False),
        ("success < 0.05", 0.01, None, True),
        ("rmse > 0.02", None, None, None),
        ("rmse > 0.02", nan, None, None),
        ("rmse > 1.5 * base", 0.03, None, None),
        ("rmse > 1.5 * base", 0.03, nan, None),
    ],
)
def test_conditions(text, value, base, holds):
    assert parse(text).holds(value, base) is holds


@pytest.mark.parametrize(
    "text",
    [
        *("", "rmse", "rmse >", "rmse == 0.02", "0.02 < rmse", "rmse > base", "rmse > mae"),
        *("rmse > 0.02 and delay > 0", "rmse > nan", "rmse > 1e999", "rmse > 1.2.3"),
        *("speed > 1", "success > 1.1 * base", "rmse > 1 * base + 1"),
    ],
)
def test_what_is_no_condition(text):
    with pytest.raises(ConfigError):
        parse(text)


@pytest.mark.parametrize(
    ("wrong", "close"), [("rmsee", "rmse"), ("rmse.left_knee", "rmse.left_knee_joint")]
)
def test_an_unknown_name_is_refused_with_those_that_there_are(wrong, close, capsys):
    missing = ["compare", "not there", "--with", "not there either"]
    assert main([*missing, "--fail-if", f"{wrong} > 1"]) == 2  # before anything is read
    said = capsys.readouterr().err
    assert close in said.split("Choose from")[0].split("Close matches")[1]
    assert "mpjpe_world" in said
    assert CONDITION_NAMES[-1] in said


@pytest.mark.parametrize(
    ("texts", "added"),
    [
        ([], []),
        (["rmse > 1"], ["completed < 1", "played < 1"]),
        (["rmse > 1", "played < 0.5"], []),
        (["success < 1"], []),
    ],
)
def test_runs_must_be_played_as_asked_unless_a_condition_is_on_that(texts, added):
    found = FailIf.parse_all(texts, CONDITION_NAMES)
    assert [one.text for one in found] == [*texts, *added]
    assert [one.default for one in found] == [False] * len(texts) + [True] * len(added)
    for one in found:
        assert one.holds(None) is (False if one.default else None)
