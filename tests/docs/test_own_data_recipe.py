"""The recipe for files of one's own leads to the right picture: the spot of its stand-ins at its place and depth."""

import re
from pathlib import Path

import numpy as np
import pytest

import nlos

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "my-data.md"


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the page's blocks were run."""
    folder = tmp_path_factory.mktemp("own")
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(code, str(PAGE), "exec"), {})
    return folder


@pytest.mark.parametrize("name", ["from_mat", "from_npz", "from_csv", "pairs"])
def test_the_spot_is_where_it_is(converted: Path, name: str) -> None:
    picture = nlos.reconstruct(converted / f"{name}.npz")
    row, col = np.unravel_index(picture.albedo.argmax(), picture.albedo.shape)
    assert picture.x_m[col] == pytest.approx(0.2, abs=0.03)
    assert picture.y_m[row] == pytest.approx(0.1, abs=0.03)
    assert picture.depth_m[row, col] == pytest.approx(0.5, abs=0.015)


def test_errors_about_unreadable_files_say_how_to_make_one_that_is_read(converted: Path) -> None:
    from nlos.acquisition.errors import InvalidData
    from nlos.acquisition.importers.own_data import SAVED
    from nlos.cli.archive import files_of
    from nlos.cli.exit_codes import UsageError

    counts = np.random.default_rng(0).poisson(1.0, (4, 4, 64))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(converted)
        exec(SAVED, {"np": np, "counts": counts})
    scan = nlos.load(converted / "scan.npz")
    np.testing.assert_array_equal(scan.counts, counts)
    assert scan.bin_width_s == 16e-12
    for name in ("lab.mat", "lab.npz", "points/x+387.5_y+387.5.csv"):
        with pytest.raises(InvalidData, match=re.escape(SAVED)):
            nlos.load(converted / name)
    with pytest.raises(UsageError, match=re.escape(SAVED)):
        files_of([converted / "points"])
    with pytest.raises(IsADirectoryError, match=re.escape(SAVED)):
        nlos.load(converted / "points")
