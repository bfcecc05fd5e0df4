from typing import get_args

import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.extras.formats.table import FORMATS, WRITTEN
from g1stream.extras.formats.write import Output
from g1stream.motion.readers import FORMATS as OF_THE_CORE
from g1stream.optional import load_object
from g1stream.types import MotionFormat


def test_each_row_names_a_function_or_an_output():
    assert all(callable(load_object(one.reader)) for one in FORMATS)
    assert all(isinstance(load_object(where), Output) for where in WRITTEN.values())
    assert set(get_args(MotionFormat)) == WRITTEN.keys()


def test_what_is_in_no_format_is_told_all_formats(tmp_path):
    path = tmp_path / "motion"
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(path)
    assert all(one.name in refused.value.remedy for one in (*OF_THE_CORE, *FORMATS))
    assert "`formats`" not in refused.value.cause


@pytest.mark.parametrize("name", ["motion.pkl", "motion.npy", "motion.pt", "motion"])
def test_an_empty_file_is_said_to_be(tmp_path, name):
    path = tmp_path / name
    path.touch()
    with pytest.raises(MotionError, match="empty"):
        g1stream.load_motion(path)
