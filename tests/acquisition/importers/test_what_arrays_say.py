"""What a stranger's arrays say of places, axes and units: taken as meant, said, or refused by name."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.separate_points import refuse_other_names
from tests.acquisition.importers.photon_files import write_photons
from tests.acquisition.importers.sdt_files import GAIN, TAC_S, write_sdt

COUNTS = np.random.default_rng(0).poisson(2.0, (8, 8, 64)).astype(np.float32)
EXPOSURE_S = np.where(np.arange(8)[:, None] < 3, 0.0, 1.0) * np.ones((8, 8))  # its first three rows were not measured
TOLD = Given(bin_width_s=32e-12, wall_m=(1.0, 1.0))


def stored(path: Path, **arrays: Any) -> Path:
    known = {"bin_width_s": 32e-12, "wall_size_m": 1.0, "rectified": True, "exposure_s": np.ones((8, 8))}
    np.savez(path, **(known | arrays))
    return path


@pytest.mark.parametrize("middle", [(3.2, 1.4), (0.7, -0.3), (0.5, 0.5), (0.5, 0.0)])
def test_free_points_far_to_one_side_are_taken_about_their_middle(tmp_path: Path, middle: tuple[float, float]) -> None:
    x_m, y_m = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 64))
    path = tmp_path / "a.npz"
    places = {"x_m": x_m + middle[0], "y_m": y_m + middle[1], "exposure_s": np.ones(64)}
    np.savez(path, histograms=COUNTS.reshape(64, 64), bin_width_s=32e-12, rectified=True, **places)
    scan = read_any(path)
    assert scan.points is not None
    told = any("which is taken for the wall's middle" in note for note in scan.notes)
    assert told == (middle != (0.5, 0.0))  # which is half a wall
    assert np.ptp(scan.points.x_m) == pytest.approx(np.ptp(x_m))
    if told:
        assert (scan.points.x_m.max() + scan.points.x_m.min()) / 2 == pytest.approx(0, abs=1e-9)
        assert scan.points.wall.width_m < 1.3
    assert read_any(path, Given(wall_m=(9.0, 9.0))).points.x_m == pytest.approx(x_m + middle[0])  # type: ignore[union-attr]


@pytest.mark.parametrize("x_first", [False, True])
def test_axes_hold_for_exposures_too(tmp_path: Path, x_first: bool) -> None:
    counts, exposure_s = (COUNTS.transpose(1, 0, 2), EXPOSURE_S.T) if x_first else (COUNTS, EXPOSURE_S)
    path = stored(tmp_path / "a.npz", histograms=counts, exposure_s=exposure_s)
    scan = read_any(path, Given(axes="XYT" if x_first else "YXT"))
    assert np.array_equal(scan.transient.exposure_s, EXPOSURE_S)
    assert np.array_equal(np.moveaxis(scan.transient.counts, 0, 2)[3:], COUNTS[3:])


@pytest.mark.parametrize("on_grid", [True, False])
def test_one_exposure_holds_for_all_points(tmp_path: Path, on_grid: bool) -> None:
    places = {} if on_grid else {"x_m": np.linspace(-0.4, 0.4, 64), "y_m": np.linspace(-0.3, 0.3, 64)}
    counts = COUNTS if on_grid else COUNTS.reshape(64, 64)
    scan = read_any(stored(tmp_path / "a.npz", histograms=counts, exposure_s=0.02, **places))
    assert np.array_equal(scan.held.exposure_s, np.full(counts.shape[:-1], 0.02))
    with pytest.raises(InvalidData, match=r"exposure_s: has shape \(3,\), .* seconds for each point .* or one number"):
        read_any(stored(tmp_path / "a.npz", histograms=counts, exposure_s=np.ones(3), **places))


def test_exposures_that_are_rows_first_already_stay(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.npz", histograms=COUNTS[:5].transpose(1, 0, 2), exposure_s=EXPOSURE_S[:5])
    scan = read_any(path, Given(axes="XYT", wall_m=(1.0, 0.625)))
    assert np.array_equal(scan.transient.exposure_s, EXPOSURE_S[:5])


@pytest.mark.parametrize("rows", [8, 5])
@pytest.mark.parametrize("with_counts", [True, False])
def test_axes_hold_for_the_place_of_every_point_too(tmp_path: Path, rows: int, with_counts: bool) -> None:
    """In the order of the histograms, or as NumPy's meshgrid makes them."""
    counts, step = COUNTS[:rows], 1 / 8
    x_m, y_m = np.meshgrid((np.arange(8) - 3.5) * step, ((rows - 1) / 2 - np.arange(rows)) * step)
    places = (x_m.T, y_m.T) if with_counts else (x_m, y_m)
    np.savez(tmp_path / "a.npz", histograms=counts.transpose(1, 0, 2), x_m=places[0], y_m=places[1], bin_width_s=32e-12,
             rectified=True)  # fmt: skip
    scan = read_any(tmp_path / "a.npz", Given(axes="XYT")).transient
    assert np.array_equal(np.moveaxis(scan.counts, 0, 2), counts)
    assert (scan.wall.width_m, scan.wall.height_m) == (pytest.approx(1.0), pytest.approx(rows / 8))


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1e30, "row 0, column 0, bin 0 is more than anybody counts, 9e"),
        (np.nan, "no point of it was measured: 64 points hold NaN alone"),
    ],
)
def test_what_nobody_counted_is_refused_by_what_it_is(tmp_path: Path, factor: float, said: str) -> None:
    with pytest.raises(InvalidData, match=said):
        read_any(stored(tmp_path / "a.npz", histograms=(COUNTS + 1) * factor))


def test_offsets_of_a_scan_that_is_rectified_are_named(tmp_path: Path) -> None:
    offsets = np.full((8, 8), 30.0)
    path = stored(tmp_path / "a.npz", histograms=COUNTS, time_offset_bins=offsets)
    assert any("not used: time_offset_bins" in note for note in read_any(path).notes)
    assert not any("not used" in note for note in read_any(path, Given(rectified=False)).notes)


def test_points_that_are_not_as_far_apart_in_x_as_in_y_are_said(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.npz", histograms=COUNTS[:5], exposure_s=np.ones((5, 8)))
    (note,) = (note for note in read_any(path, TOLD).notes if "as given" in note and "wall" in note)
    assert "points 12.5 cm apart in x and 20 cm in y" in note
    assert not any("apart in x" in note for note in read_any(path, Given(wall_m=(1.0, 0.625))).notes)


def test_histograms_whose_time_seems_first_may_have_all_axes_reversed(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match=r"--axes TYX, TXY where x comes before y"):
        read_any(stored(tmp_path / "a.npz", histograms=COUNTS.transpose(2, 1, 0)))


def matlab(path: Path, **arrays: Any) -> Path:
    scipy.io.savemat(path, arrays)
    return path


def test_another_labs_rect_data_needs_its_order(tmp_path: Path) -> None:
    path = matlab(tmp_path / "a.mat", rect_data=COUNTS)
    with pytest.raises(InvalidData, match=r"in which x is the first axis and falls; .* --axes YXT, or XYT"):
        read_any(path, TOLD)
    for axes, expected in (("YXT", COUNTS), ("XYT", COUNTS.transpose(1, 0, 2))):
        said = Given(bin_width_s=32e-12, wall_m=(1.0, 1.0), axes=axes)
        assert np.array_equal(np.moveaxis(read_any(path, said).transient.counts, 0, 2), expected)
    theirs = matlab(tmp_path / "b.mat", rect_data=COUNTS, width=0.35)
    scan = read_any(theirs, Given(bin_width_s=32e-12))
    assert np.array_equal(np.moveaxis(scan.transient.counts, 0, 2), COUNTS.transpose(1, 0, 2)[:, ::-1])
    assert any("x is its first axis and falls" in note for note in scan.notes)


def test_a_measurement_without_its_tofgrid_is_only_assumed_to_be_rectified(tmp_path: Path) -> None:
    path = matlab(tmp_path / "a.mat", meas=COUNTS)
    scan = read_any(path, TOLD)
    assert scan.rectified
    assert scan.rectified_assumed
    assert any("no tofgrid in it, nor in a tof.mat beside it" in note for note in scan.notes)
    told = read_any(path, Given(bin_width_s=32e-12, wall_m=(1.0, 1.0), rectified=True))
    assert not told.rectified_assumed


@pytest.mark.parametrize(
    "names",
    [("laser_pos", "spad_pos"), ("laserPos", "cameraPos"), ("laserpoints", "detectpoints"), ("SPAD_index",)],
)
def test_scans_with_places_of_the_sensor_are_not_taken_for_confocal(names: tuple[str, ...]) -> None:
    with pytest.raises(InvalidData, match="laser_m and sensor_m"):
        refuse_other_names("a.mat", ("meas", *names))
    refuse_other_names("a.mat", ("meas", "laser_power", "camera"))


@pytest.mark.parametrize("form", ["npz", "sdt", "hdf5"])
@pytest.mark.parametrize("given_ps", [16.0, None])
def test_bins_that_are_given_in_place_of_a_files_own_are_noted(
    tmp_path: Path, form: str, given_ps: float | None
) -> None:
    """In the units of people: whoever reads a picture's depths must know that the file said otherwise."""
    photons, path = COUNTS.astype(np.uint16), tmp_path / f"a.{form}"
    stored_ps = TAC_S / GAIN / 64 * 1e12 if form == "sdt" else 32.0
    if form == "npz":
        stored(path, histograms=photons)
    elif form == "sdt":
        write_sdt(path, [photons])
    else:
        write_photons(path, photons, 32e-12)
    scan = read_any(path, Given(bin_width_s=given_ps and given_ps * 1e-12))
    assert scan.transient.time.bin_width_s == pytest.approx((given_ps or stored_ps) * 1e-12)
    said = [note.split("bins of 16 ps, as given (") for note in scan.notes if "as given" in note]
    assert [float(after.removesuffix(" ps in the file)")) for _, after in said] == (
        [pytest.approx(stored_ps, rel=1e-5)] if given_ps else []
    )


@pytest.mark.parametrize(
    ("x_from", "y_from", "said"), [(0, None, ["x_m"]), (-7, 3, ["y_m"]), (-7, -7, []), (None, None, [])]
)
def test_a_grid_about_another_place_than_its_middle_is_said_once_for_each_axis(
    tmp_path: Path, x_from: int | None, y_from: int | None, said: list[str]
) -> None:
    """Eight whole numbers of metres, two apart; where an axis is not said, nothing is of it."""
    steps = 2 * np.arange(8)
    places = {
        "x_m": None if x_from is None else x_from + steps,
        "y_m": None if y_from is None else y_from + steps[::-1],
    }
    told = {name: line for name, line in places.items() if line is not None}
    scan = read_any(stored(tmp_path / "a.npz", histograms=COUNTS, wall_size_m=16.0, **told))
    notes = [note for note in scan.notes if "in the middle of the grid" in note]
    middles = {"x_m": "x_m is 7 m", "y_m": "y_m is 10 m"}
    assert [note.startswith(middles[name]) for note, name in zip(notes, said, strict=True)] == [True] * len(said)
    assert (scan.transient.wall.width_m, scan.transient.wall.height_m) == pytest.approx((16.0, 16.0))


def test_places_that_are_words_are_refused(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.npz", histograms=COUNTS, x_m=np.array([f"{k}" for k in range(8)]))
    with pytest.raises(InvalidData, match="x_m: holds values that are no finite numbers of metres"):
        read_any(path)
