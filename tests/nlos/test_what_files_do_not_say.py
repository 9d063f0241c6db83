"""What a file does not say is found, given or assumed - aloud."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.given import Given
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.chain import calibrate_scan
from nlos.loaded import load_scan
from nlos.recon.depth_range import within_depths
from nlos.recon.errors import InvalidData as ReconInvalidData
from nlos.recon.volume import Reconstruction, Volume

PTU = Path(__file__).parents[3] / "shared" / "data" / "tcspc" / "replay_s_u.ptu"
COUNTS = np.random.default_rng(0).poisson(1.0, (8, 8, 128)).astype(np.uint16)


def write(path: Path, counts: np.ndarray, **more: object) -> Path:
    with h5py.File(path, "w") as file:
        file["histograms"] = counts
        for name, value in more.items():
            if isinstance(value, np.ndarray):
                file[name] = value
            else:
                file.attrs[name] = value
    return path


@pytest.mark.skipif(not PTU.is_file(), reason="no shared data")
def test_the_wall_of_a_ptu_is_found_by_its_direct_times(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "nlos"):
        found = load_scan(PTU).transient.wall
    assert found.width_m == pytest.approx(0.7, abs=0.003)
    assert "by the direct times it is 0.70" in caplog.text
    assert load_scan(PTU, Given(wall_m=(0.7, 0.6))).transient.wall == WallGrid(0.7, 0.6, 64, 64)


def test_time_first_is_noticed_and_axes_say_it(tmp_path: Path) -> None:
    path = write(tmp_path / "tyx.h5", np.moveaxis(COUNTS, 2, 0), bin_width_s=32e-12, wall_size_m=1.0)
    with pytest.raises(InvalidData, match="is time the first axis"):
        load_scan(path)
    read = load_scan(path, Given(axes="TYX")).transient
    assert np.array_equal(read.counts, np.moveaxis(COUNTS, 2, 0))
    assert read.time == TimeAxis(128, 32e-12)
    assert load_scan(path, Given(axes="YXT")).transient.time.bins == 8
    with pytest.raises(InvalidData, match="does not name its 3 axes"):
        load_scan(path, Given(axes="TX"))


def test_what_is_given_goes_where_the_file_says_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "bare.h5", COUNTS)
    with pytest.raises(InvalidData, match="--bin-width-ps"):
        load_scan(path)
    with pytest.raises(InvalidData, match="--wall-size-m"):
        load_scan(path, Given(bin_width_s=16e-12))
    scan = load_scan(path, Given((2.0, 1.5), 16e-12, rectified=False))
    assert (scan.transient.wall, scan.transient.time.bin_width_s) == (WallGrid(2.0, 1.5, 8, 8), 16e-12)
    assert not scan.rectified


@pytest.mark.parametrize("suffix", [".h5", ".npz"])
def test_free_positions_are_read(tmp_path: Path, suffix: str) -> None:
    x_m, y_m = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 64))
    arrays = {"x_m": x_m, "y_m": y_m, "exposure_s": np.full(64, 0.5)}
    counts, path = COUNTS.reshape(64, 128), tmp_path / f"free{suffix}"
    if suffix == ".h5":
        write(path, counts, bin_width_s=32e-12, **arrays)
    else:
        np.savez(path, histograms=counts, bin_width_s=32e-12, rectified=1, **arrays)
    scan = load_scan(path)
    assert scan.points is not None
    assert np.array_equal(scan.points.counts, counts)
    assert np.array_equal(scan.points.x_m, x_m)
    assert np.array_equal(scan.points.exposure_s, arrays["exposure_s"])
    assert float(scan.transient.counts.sum()) == counts.sum()
    assert scan.transient.wall.width_m >= 2 * np.abs(x_m).max()


def test_a_record_that_begins_later_than_it_is_long_is_refused_by_its_offset(tmp_path: Path) -> None:
    said = {"bin_width_s": 32e-12, "wall_size_m": 1.0, "rectified": True}
    for late, refused in ((2e-9, False), (60e-9, True)):
        path = write(tmp_path / "late.h5", COUNTS, **said, offset_s=late)
        if refused:
            with pytest.raises(ReconInvalidData, match=r"offset_s: the first bin begins 60 ns after .* last 4\.096 ns"):
                calibrate_scan(load_scan(path))
        else:
            assert calibrate_scan(load_scan(path)).counts.any()


def test_import_says_the_wall_that_was_given(nlos, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    write(tmp_path / "bare.h5", COUNTS)
    done = nlos("import", "bare.h5", "-o", "run.h5", "--wall-size-m", "0.7x0.6", "--bin-width-ps", "32", "--raw")
    assert done.returncode == 0, done.stderr
    assert "0.7" in nlos("info", "run.h5").stdout
    assert "assuming 1 m x" not in done.stderr
    for words in ("wide", "1x"):
        assert nlos("import", "bare.h5", "-o", "x.h5", "--wall-size-m", words).returncode == 2


def test_a_range_of_depths_limits_picture_and_volume() -> None:
    albedo = np.zeros((10, 2, 2), np.float32)
    albedo[3], albedo[8] = 1.0, 5.0
    volume = Volume(albedo, np.linspace(0.1, 1.0, 10), WallGrid(1.0, 1.0, 2, 2))
    whole = Reconstruction(albedo.max(0), np.full((2, 2), 0.9, np.float32), volume.wall, "lct", 0.0, {}, volume)
    near = within_depths(whole, 0.2, 0.6)
    assert near.volume is not None
    assert near.volume.depths_m.tolist() == pytest.approx([0.2, 0.3, 0.4, 0.5, 0.6])
    assert near.albedo.max() == 1.0
    assert not within_depths(replace(whole, volume=None), 0.2, 0.6).albedo.any()
