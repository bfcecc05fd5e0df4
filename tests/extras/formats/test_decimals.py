import numpy as np

from g1stream.extras.formats.decimals import write_rows


def test_numbers_in_text_across_blocks(tmp_path):
    """As Python writes them; but zero has no sign."""
    values = np.arange(-3000, 3000).reshape(2000, 3) / 7
    values[:2] = [-0.0, 0.0, 0.5], [0.9999997, -1e-6, 9998.9999999]
    with (path := tmp_path / "rows.csv").open("wb") as file:
        write_rows(file, values, "motion")
    expected = "".join(",".join(f"{x + 0.0:.6f}" for x in row) + "\n" for row in values.tolist())
    assert path.read_text() == expected
