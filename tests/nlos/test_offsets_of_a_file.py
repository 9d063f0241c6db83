"""`--set offsets=file`: a file's own offsets align it, the bench's constants correct the rest, as they do without."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.__main__ import run
from nlos.calibration.constants import BenchConstants, Quantity, save
from nlos.chain import calibrate_scan
from nlos.loaded import load_scan

SHAPE, BIN_S, OFFSET, SPIKE = (4, 4, 128), 32e-12, 10, 70


def write(path: Path, *, rectified: bool, free: bool = False) -> None:
    """Direct light in bin `OFFSET`, and what the detector counts in the dark in bin `SPIKE` alone."""
    counts = np.zeros(SHAPE, np.uint16)
    counts[..., OFFSET], counts[..., OFFSET + 40], counts[..., SPIKE] = 5000, 50, 300
    with h5py.File(path, "w") as file:
        file["histograms"] = counts.reshape(-1, SHAPE[2]) if free else counts
        if not free:
            file["time_offset_bins"] = np.full(SHAPE[:2], float(OFFSET))
        else:
            file["x_m"], file["y_m"] = (axis.ravel() for axis in np.mgrid[:4, :4] * 0.1 - 0.2)
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": 1.2, "rectified": int(rectified)})


def test_a_file_that_does_not_say_whether_it_is_rectified_is_shifted_as_asked(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(tmp_path / "raw.h5", rectified=False)
    write(tmp_path / "silent.h5", rectified=False)
    with h5py.File(tmp_path / "silent.h5", "a") as file:
        del file.attrs["rectified"]
    raw, silent = (load_scan(tmp_path / f"{name}.h5") for name in ("raw", "silent"))
    with caplog.at_level("INFO"):
        shifted = calibrate_scan(silent, True)
    assert "taken for raw" in caplog.text
    assert np.array_equal(shifted.counts, calibrate_scan(raw, True).counts)
    assert not np.array_equal(calibrate_scan(silent).counts, shifted.counts)
    cut = calibrate_scan(replace(silent, direct_cut_bins=45), True).counts  # counted from where it was shifted to
    assert np.array_equal(cut[45:], shifted.counts[45:])
    assert not cut[:45].any()


def dark_constants() -> BenchConstants:
    dark_hz = np.zeros(SHAPE[2])
    dark_hz[SPIKE] = 300.0  # a file that does not say its exposure has 1 s
    return BenchConstants(
        {}, "2026-01-01T00:00:00", ("dark.h5",), BIN_S, dark_hz=Quantity(300.0, 1.0), dark_per_bin_hz=dark_hz
    )


def test_constants_correct_a_file_that_brings_its_offsets(tmp_path: Path) -> None:
    write(tmp_path / "scan.h5", rectified=False)
    scan = load_scan(tmp_path / "scan.h5")
    without, corrected = (calibrate_scan(scan, True, constants).counts for constants in (None, dark_constants()))
    spike = SPIKE - OFFSET
    assert without[spike].min() > 250
    assert abs(corrected[spike]).max() < 1
    assert np.array_equal(np.delete(corrected, spike, 0), np.delete(without, spike, 0))


def test_the_command_corrects_it_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "scan.h5", rectified=False)
    save(dark_constants(), tmp_path / "c.h5")
    words = ["reconstruct", "scan.h5", "--method", "backprojection", "--set", "offsets=file"]
    assert run([*words, "-o", "without", "--constants", "none"]) == 0
    assert run([*words, "-o", "with", "--constants", "c.h5"]) == 0
    with h5py.File("without/reconstruction.h5") as one, h5py.File("with/reconstruction.h5") as other:
        assert not np.allclose(one["albedo"][()], other["albedo"][()], rtol=0.01)


@pytest.mark.parametrize(
    ("how", "words"),
    [({"rectified": True}, "time 0 is the wall already"), ({"rectified": False, "free": True}, "at free positions")],
)
def test_offsets_that_would_not_be_used_are_refused(
    tmp_path: Path, how: dict[str, bool], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "scan.h5", **how)
    done = ["reconstruct", str(tmp_path / "scan.h5"), "-o", str(tmp_path / "out"), "--set", "offsets=file"]
    assert run(done) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
