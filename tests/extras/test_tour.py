from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbclient is not installed")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

NOTEBOOK = Path(__file__).parents[2] / "examples" / "tour.ipynb"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_notebook_runs(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    short = 'seconds=0.5, config=g1stream.load_config(over={"stream.ramp": 0.5, "stream.hold": 0})'
    for cell in notebook.cells:
        cell.source = cell.source.replace("seconds=4.0", short).replace("=3.0", "=0.4")
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, kernel_name="python3", resources=where).execute()
    assert notebook.cells[-1].outputs[0].text == "True\n"
    assert (tmp_path / "tour.mp4").stat().st_size > 10_000


def test_the_notebook_is_kept_with_its_outputs():
    cells = [
        cell for cell in nbformat.read(NOTEBOOK, as_version=4).cells if cell.cell_type == "code"
    ]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell.outputs for cell in cells)
    assert NOTEBOOK.stat().st_size < 1_000_000
