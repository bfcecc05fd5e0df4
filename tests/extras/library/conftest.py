import pytest

import g1stream
from dask_cluster import dask_cluster


@pytest.fixture(scope="session")
def motions(tmp_path_factory):
    """A directory with three motions of a second, one of them twice, and a file that is none."""
    directory = tmp_path_factory.mktemp("motions")
    demo = g1stream.load_motion("demo")
    demo.trim(0.0, 1.0).save(directory / "first.npz")
    demo.trim(1.0, 2.0).save(directory / "second.csv")
    (directory / "below").mkdir()
    demo.trim(2.0, 3.0).mirrored().save(directory / "below" / "third.npz")
    (directory / "below" / "copy.npz").write_bytes((directory / "first.npz").read_bytes())
    (directory / "broken.csv").write_text("left_knee_joint\nstraight\nbent\n")
    (directory / "notes.txt").write_text("no motion")
    (directory / ".hidden.csv").write_text("no motion")
    return directory


@pytest.fixture(scope="session")
def cluster():
    """Address of a scheduler with one worker, for tests that are not about processes."""
    with dask_cluster() as (address, _, _):
        yield address


@pytest.fixture(scope="session")
def checked(motions, tmp_path_factory):
    """The library of the motions, checked."""
    out = tmp_path_factory.mktemp("library")
    run = g1stream.library.run_library(
        [str(motions)], [g1stream.library.LibraryCase("check", out)], workers=2
    )
    return run, out


@pytest.fixture(scope="session")
def many(tmp_path_factory):
    """A directory with 120 different motions of a second."""
    directory = tmp_path_factory.mktemp("many")
    demo = g1stream.load_motion("demo")
    for i in range(120):
        demo.trim(0.1 * i, 0.1 * i + 1.0).save(directory / f"{i:03}.npz")
    return directory
