"""A scan that is said to be what it is not is told so, with the word that corrects it; one that is what it says is
not."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos import load, reconstruct
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.seems_raw import aligned_later_s, mean_arrival_s
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface
from nlos.recon.errors import InvalidData
from tests.command import nlos

SIDE, BINS, BIN_S, WALL_M, AWAY_M, DWELL_S = 16, 1024, 16e-12, 0.9, 1.6, 0.3
AT_M = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
LETTER = Surface(letter="F", centre_m=(0.0, 0.0, 0.7), height_m=0.6)
BOARD = Surface(centre_m=(0.0, 0.0, 0.9), panel_m=(0.8, 0.8))
DOT = Surface(centre_m=(0.1, 0.1, 0.5), panel_m=(0.03, 0.03))


@cache
def photons(hidden: Surface, direct_cps: float, from_wall: bool) -> np.ndarray:
    """Drawn counts (H, W, T) of the simulated bench's scene: timed by its clock, or from each point of the wall."""
    scene = SceneSettings(objects=(hidden,), direct_cps=direct_cps, ambient_cps=100.0)
    path = BeamPath(AWAY_M)
    light = SceneLight(scene, DetectorSettings(dark_cps=100.0), path, 10e6, seed=5)
    rng, counts = np.random.default_rng(2), np.zeros((SIDE, SIDE, BINS), np.uint16)
    for row, y_m in enumerate(-AT_M):
        for col, x_m in enumerate(AT_M):
            y_rad = np.arctan(y_m / AWAY_M)
            spot = path.spot(MirrorAngles(float(np.arctan(x_m * np.cos(y_rad) / AWAY_M)), float(y_rad)))
            assert spot is not None
            begins_s = 2 * spot.range_m / 299792458 if from_wall else 8e-9
            expected = light.photons_per_pulse(spot, BIN_S, begins_s)[:BINS]
            counts[row, col, : len(expected)] = rng.poisson(expected * 10e6 * DWELL_S)
    counts.flags.writeable = False
    return counts


def points(counts: np.ndarray) -> RawPoints:
    x_m, y_m = (each.ravel() for each in np.meshgrid(AT_M, -AT_M))
    nothing = np.zeros(SIDE * SIDE)
    return RawPoints(counts.reshape(-1, BINS), x_m, y_m, nothing + DWELL_S, nothing, nothing, TimeAxis(BINS, BIN_S))


def write(folder: Path, counts: np.ndarray) -> None:
    with h5py.File(folder / "scan.h5", "w") as file:
        file["histograms"] = counts
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": WALL_M})


@pytest.mark.parametrize("hidden", [LETTER, DOT], ids=["letter", "dot"])
def test_scans_with_direct_light_seem_raw(hidden: Surface) -> None:
    """A letter's light is no single pulse, a dot's has no delay."""
    raw = points(photons(hidden, direct_cps=40000.0, from_wall=False))
    arrival_s = mean_arrival_s(raw)
    assert arrival_s is not None
    ranges_m = np.sqrt(raw.x_m**2 + raw.y_m**2 + AWAY_M**2)
    assert arrival_s == pytest.approx(float(np.mean(2 * ranges_m / 299792458)) - 8e-9, abs=100e-12)
    begun_late = replace(raw, time=TimeAxis(BINS, BIN_S, 6e-9))
    assert mean_arrival_s(begun_late) == pytest.approx(arrival_s + 6e-9, abs=1e-12)
    assert mean_arrival_s(points(photons(hidden, direct_cps=0.0, from_wall=True))) is None


def test_an_aligned_scan_with_its_direct_light_is_told_of_raw(tmp_path: Path) -> None:
    write(tmp_path, photons(LETTER, direct_cps=400000.0, from_wall=True))
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "a")
    assert done.returncode == 0, done.stderr
    assert "direct light is still in it" in done.stderr
    assert "--raw" in done.stderr
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "b", "--raw")
    assert done.returncode == 0, done.stderr
    assert "at the same time" in done.stderr
    assert "--rectified" not in done.stderr
    assert "scan's own direct peak" in done.stdout


def test_a_raw_scan_that_counts_as_rectified_is_told_of_raw(tmp_path: Path) -> None:
    write(tmp_path, photons(LETTER, direct_cps=40000.0, from_wall=False))
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "a")
    assert "is time 0 the wall?" in done.stderr
    assert "--raw" in done.stderr
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "b", "--raw")
    assert done.returncode == 0, done.stderr
    assert "is time 0" not in done.stderr
    told = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "c", "--rectified")
    assert "is time 0" not in told.stderr
    assert "warning" not in told.stderr


def test_a_rectified_scan_that_counts_as_raw_is_told_of_rectified(tmp_path: Path) -> None:
    write(tmp_path, photons(BOARD, direct_cps=0.0, from_wall=True))
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "a", "--raw")
    assert "--rectified" in done.stderr
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "b", "--rectified")
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr


def test_what_to_know_about_the_explained_light_is_printed_and_reported(tmp_path: Path) -> None:
    write(tmp_path, photons(LETTER, direct_cps=400000.0, from_wall=True))
    done = nlos(tmp_path, "reconstruct", "scan.h5", "-o", "a", "--raw")
    with h5py.File(tmp_path / "a" / "reconstruction.h5") as made:
        note = str(made.attrs["explained_note"])
    assert "noise is estimated" in note
    assert f"({note})" in done.stdout
    assert nlos(tmp_path, "import", "scan.h5", "-o", "run.h5", "--raw").returncode == 0
    assert nlos(tmp_path, "report", "run.h5", "-o", "r.html", "--methods", "lct").returncode == 0
    assert note in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("hidden", [LETTER, BOARD, DOT], ids=["letter", "board", "dot"])
@pytest.mark.parametrize("late", [12, 40])
def test_direct_light_that_was_aligned_to_a_later_bin_is_seen(hidden: Surface, late: int) -> None:
    """Others leave so many bins before it; hidden light alone never comes at one time."""
    counts = photons(hidden, direct_cps=400000.0, from_wall=True)
    later = np.zeros_like(counts)
    later[:, :, late:] = counts[:, :, :-late]
    found = aligned_later_s(points(later))
    assert found is not None
    assert found == pytest.approx(late * BIN_S, abs=4 * BIN_S)
    assert aligned_later_s(points(photons(hidden, direct_cps=0.0, from_wall=True))) is None


@pytest.mark.sampled(3)
@pytest.mark.parametrize("said", [np.False_, 0, np.int64(0), np.array(False)], ids=repr)
def test_an_array_is_raw_however_python_and_files_say_so(said: object) -> None:
    counts = photons(LETTER, direct_cps=400000.0, from_wall=False)
    raw, told = (
        reconstruct(counts, wall=WALL_M, bin_width=BIN_S, rectified=each)  # type: ignore[arg-type]
        for each in (False, said)
    )
    np.testing.assert_array_equal(told.albedo, raw.albedo)
    for wrong in ("no", 2, 0.0, [True, False]):
        with pytest.raises(InvalidData, match=r"rectified=.*True .* or False is expected"):
            reconstruct(counts, wall=WALL_M, bin_width=BIN_S, rectified=wrong)  # type: ignore[arg-type]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("stored", [True, False, None])
@pytest.mark.parametrize("said", [True, False])
def test_what_python_says_goes_before_what_a_file_says(tmp_path: Path, said: bool, stored: bool | None) -> None:
    counts = photons(LETTER, direct_cps=0.0 if said else 400000.0, from_wall=said)
    write(tmp_path, counts)
    if stored is not None:
        with h5py.File(tmp_path / "scan.h5", "a") as file:
            file.attrs["rectified"] = stored
    right = reconstruct(counts, wall=WALL_M, bin_width=BIN_S, rectified=said)
    for scan in (tmp_path / "scan.h5", load(tmp_path / "scan.h5")):
        np.testing.assert_array_equal(reconstruct(scan, rectified=said).albedo, right.albedo)


def test_of_a_scan_that_is_said_to_be_raw_nothing_was_cut(tmp_path: Path) -> None:
    """A file's own cut belongs to a rectified scan: without it, direct light is looked for and removed."""
    counts = photons(LETTER, direct_cps=400000.0, from_wall=False)
    x_m, y_m = (each.ravel() for each in np.meshgrid(AT_M, -AT_M))
    with h5py.File(tmp_path / "cut.h5", "w") as file:
        file["histograms"], file["x_m"], file["y_m"] = counts.reshape(-1, BINS), x_m, y_m
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": WALL_M, "rectified": True, "direct_cut_bins": 40})
    assert nlos(tmp_path, "import", "cut.h5", "-o", "run.h5").returncode == 0
    of_arrays = reconstruct(
        counts.reshape(-1, BINS), points=(x_m, y_m), wall=WALL_M, bin_width=BIN_S, rectified=False
    )  # fmt: skip
    for name in ("cut.h5", "run.h5"):
        np.testing.assert_allclose(
            reconstruct(tmp_path / name, rectified=False).albedo, of_arrays.albedo, rtol=1e-4, atol=1e-4
        )
