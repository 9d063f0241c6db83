"""Plain arrays mean the same in HDF5, NPZ and MAT: each histogram stays where its beam was, what is not said is assumed
by one rule and aloud, and what contradicts itself is refused."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import ImportedScan

ROWS, COLS, BINS = 4, 6, 96
X_M, Y_M = np.linspace(-0.5, 0.5, COLS), np.linspace(0.3, -0.3, ROWS)
WALL_M = (1.2, 0.8)
FORMATS = (".h5", ".npz", ".mat", ".v73.mat")


def at(x_m: float, y_m: float) -> int:
    """The bin that lights up where the beam was: no two places share it."""
    return int(np.abs(X_M - x_m).argmin() * ROWS + np.abs(Y_M - y_m).argmin())


COUNTS = np.zeros((ROWS, COLS, BINS), np.uint16)
for _row, _y in enumerate(Y_M):
    for _col, _x in enumerate(X_M):
        COUNTS[_row, _col, at(_x, _y)] = 9
WHOLE = {"histograms": COUNTS, "bin_width_s": 32e-12, "wall_size_m": WALL_M}


def write(path: Path, arrays: dict[str, object]) -> Path:
    """As a user would, with the tool of the format."""
    if path.name.endswith(".v73.mat"):  # MATLAB itself: axes reversed, numbers as 1 x 1 arrays
        with h5py.File(path, "w", userblock_size=512) as file:
            for key, value in arrays.items():
                file[key] = np.atleast_2d(np.asarray(value)).T
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for key, value in arrays.items():
                if np.ndim(value) > 0 and key != "wall_size_m":
                    file[key] = value
                else:
                    file.attrs[key] = value
    elif path.suffix == ".npz":
        np.savez(path, **arrays)
    else:
        savemat(path, arrays)
    return path


def read(folder: Path, suffix: str, arrays: dict[str, object], **given: object) -> ImportedScan:
    return read_any(write(folder / f"scan{suffix}", arrays), Given(**given))  # type: ignore[arg-type]


def each_where_its_beam_was(scan: ImportedScan) -> bool:
    held = scan.transient
    lit = held.counts.argmax(axis=0)
    return all(
        lit[row, col] == at(x_m, y_m)
        for row, y_m in enumerate(held.wall.y_m())
        for col, x_m in enumerate(held.wall.x_m())
    )


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("down", [False, True], ids=["rows from the top", "rows from the bottom"])
@pytest.mark.parametrize("left", [False, True], ids=["columns from the left", "columns from the right"])
@pytest.mark.parametrize("mesh", [False, True], ids=["lines", "meshgrid"])
def test_positions_turn_the_array_upright(suffix: str, down: bool, left: bool, mesh: bool, tmp_path: Path) -> None:
    rows, cols = slice(None, None, -1 if down else 1), slice(None, None, -1 if left else 1)
    places = dict(zip(("x_m", "y_m"), np.meshgrid(X_M[cols], Y_M[rows]) if mesh else (X_M[cols], Y_M[rows]),
                      strict=True))  # fmt: skip
    exposure = 1.0 + COUNTS.argmax(axis=2)
    arrays = {**WHOLE, **places, "histograms": COUNTS[rows, cols], "exposure_s": exposure[rows, cols]}
    scan = read(tmp_path, suffix, arrays)
    assert each_where_its_beam_was(scan)
    assert np.array_equal(scan.held.exposure_s, exposure)
    assert any("turned round" in note for note in scan.notes) == (down or left)


@pytest.mark.parametrize("suffix", FORMATS)
def test_other_orders_are_named_and_places_still_hold(suffix: str, tmp_path: Path) -> None:
    """The lab of the README: (time, x, y), x counted from right to left."""
    stored = COUNTS[:, ::-1].transpose(2, 1, 0)
    scan = read(tmp_path, suffix, {**WHOLE, "histograms": stored, "x_m": X_M[::-1], "y_m": Y_M}, axes="TXY")
    assert each_where_its_beam_was(scan)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("told", [{}, {"wall_size_m": WALL_M}, {"wall_size_m": (1.0, 0.6)}],
                         ids=["places alone", "both", "from the first to the last"])  # fmt: skip
def test_the_wall_is_a_step_wider_than_its_places(suffix: str, told: dict[str, object], tmp_path: Path) -> None:
    arrays = {"histograms": COUNTS, "bin_width_s": 32e-12, "x_m": X_M, "y_m": Y_M, **told}
    scan = read(tmp_path, suffix, arrays)
    assert (scan.held.wall.width_m, scan.held.wall.height_m) == pytest.approx(WALL_M)
    assert np.allclose(scan.held.wall.x_m(), X_M)
    assert np.allclose(scan.held.wall.y_m(), Y_M)


@pytest.mark.parametrize("suffix", FORMATS)
def test_arrays_are_rectified_unless_they_say_otherwise(suffix: str, tmp_path: Path) -> None:
    silent = read(tmp_path, suffix, WHOLE)
    assert silent.rectified
    assert any("time 0 is the wall" in note and "--raw" in note for note in silent.notes)
    for word in (False, 0, np.bool_(False), np.uint8(0)):
        raw = read(tmp_path, suffix, {**WHOLE, "rectified": word})
        assert not raw.rectified
        assert not any("rectified" in note for note in raw.notes)
    for word in (True, 1, 1.0, np.bool_(True)):
        assert read(tmp_path, suffix, {**WHOLE, "rectified": word}).rectified
    assert not read(tmp_path, suffix, WHOLE, rectified=False).rectified
    assert read(tmp_path, suffix, {**WHOLE, "rectified": 0}, rectified=True).rectified
    with pytest.raises(InvalidData, match="rectified is 2; true or false"):
        read(tmp_path, suffix, {**WHOLE, "rectified": 2})
    if suffix in (".h5", ".npz"):
        with pytest.raises(InvalidData, match="rectified is 'true'; true or false, 1 or 0"):
            read(tmp_path, suffix, {**WHOLE, "rectified": "true"})


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_line_of_points_may_say_where_each_is(suffix: str, tmp_path: Path) -> None:
    """As NumPy's meshgrid makes it, of one row and of one column; clicks alone, too, are counts."""
    for lines in (np.s_[:1], np.s_[:, :1]):
        x_m, y_m = (each[lines] for each in np.meshgrid(X_M, Y_M))
        counts = COUNTS[lines] > 0
        line = read(tmp_path, suffix, {**WHOLE, "histograms": counts, "wall_size_m": (1, 1), "x_m": x_m, "y_m": y_m} |
                    ({"wall_size_m": (1.2, 0.2)} if len(x_m) == 1 else {"wall_size_m": (0.2, 0.8)}))  # fmt: skip
        assert np.array_equal(np.moveaxis(line.transient.counts, 0, 2), counts)


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_documented_key_is_read_and_every_other_is_named(suffix: str, tmp_path: Path) -> None:
    more = {"direct_cut_bins": 3, "falloff_exponent_authors": 2, "time_offset_bins": np.ones((ROWS, COLS)),
            "response_fwhm_ps": 90.0, "wall_szie_m": 3.0, "operator": 7}  # fmt: skip
    scan = read(tmp_path, suffix, WHOLE | more)
    assert (scan.held.wall.width_m, scan.held.wall.height_m) == WALL_M
    assert (scan.direct_cut_bins, scan.falloff) == (3, 2)
    assert scan.time_offset_bins is not None
    assert scan.response is not None
    assert scan.response.fwhm_s == pytest.approx(90e-12, rel=0.02)
    assert "not used: operator, wall_szie_m" in scan.notes
    raw = read(tmp_path, suffix, WHOLE | more | {"rectified": 0})
    assert raw.direct_cut_bins == 0
    assert any(note.startswith("not used: direct_cut_bins") for note in raw.notes)


def test_keys_that_cannot_be_read_without_trust_are_named_too(tmp_path: Path) -> None:
    """NumPy stores a dictionary as a pickle, which is not opened."""
    scan = read(tmp_path, ".npz", WHOLE | {"meta": {"who": "lab"}})
    assert "not used: meta" in scan.notes


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"x_m": X_M * 100, "y_m": Y_M * 100}, "wall_size_m says 1.2 m, x_m a wall of 120 m"),
        ({"x_m": X_M, "y_m": Y_M, "wall_size_m": 0.7}, "wall_size_m says 0.7 m"),
        ({"x_m": np.sort(X_M**3 + X_M), "y_m": Y_M}, "not evenly spaced"),
        ({"x_m": X_M[:-1], "y_m": Y_M}, "5 positions for 6 columns"),
        ({"time_offset_bins": np.ones((2, 2))}, "time_offset_bins"),
        ({"direct_cut_bins": BINS}, "direct_cut_bins is 96"),
        ({"direct_cut_bins": 2.5}, "direct_cut_bins is 2.5; whole bins are cut"),
        ({"falloff_exponent_authors": 3}, "2 or 4"),
        ({"wall_size_m": -1.0}, "wall_size_m"),
        ({"bin_width_s": 32.0}, "expected 1e-13 to 1e-6"),
    ],
)
def test_what_contradicts_itself_is_refused(suffix: str, more: dict[str, object], named: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match=named):
        read(tmp_path, suffix, WHOLE | more)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_wall_that_nobody_told_is_looked_for_in_raw_scans_alone(suffix: str, tmp_path: Path) -> None:
    silent = {"histograms": COUNTS, "bin_width_s": 32e-12}
    with pytest.raises(InvalidData, match="--wall-size-m"):
        read(tmp_path, suffix, silent)
    assert read(tmp_path, suffix, silent, wall_m=WALL_M).wall_known
    raw = read(tmp_path, suffix, silent | {"rectified": False})
    assert not raw.wall_known
    assert any(note.startswith("the wall's size is not stored") for note in raw.notes)


@pytest.mark.parametrize("suffix", FORMATS)
def test_free_points_lie_on_the_wall_that_is_told(suffix: str, tmp_path: Path) -> None:
    x_m, y_m = (places.ravel() for places in np.meshgrid(X_M, Y_M))
    free = {**WHOLE, "histograms": COUNTS.reshape(-1, BINS), "x_m": x_m, "y_m": y_m}
    points = read(tmp_path, suffix, free).points
    assert points is not None
    assert all(points.counts[n].argmax() == at(x_m[n], y_m[n]) for n in range(len(x_m)))
    derived = read(tmp_path, suffix, {name: values for name, values in free.items() if name != "wall_size_m"})
    width_m, height_m = derived.held.wall.width_m, derived.held.wall.height_m
    assert f"the wall's size is not stored; by its points it is {width_m:.4g} x {height_m:.4g} m" in derived.notes
    with pytest.raises(InvalidData, match=r"beyond the edge of a wall of 1\.2 x 0\.8 m"):
        read(tmp_path, suffix, free | {"x_m": x_m * 100})
