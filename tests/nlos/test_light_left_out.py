"""A scan that was recorded too briefly at some points: how deep its picture reaches, and what is not in it."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.__main__ import run
from tests.calibration.conftest import make_raw_scan


@pytest.mark.parametrize("bins", [None, 230])
def test_light_behind_the_shortest_record_is_said(
    bins: int | None, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scan = make_raw_scan(hidden_counts=300, delay_s=-12e-9)
    ends = None if bins is None else int(scan.arrival_bins.max()) + bins
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file["histograms"] = scan.counts.reshape(16, 16, -1)[..., :ends]
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = scan.bin_width_s, 2.0
        file.attrs["rectified"] = False
    assert run(["reconstruct", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "out")]) == 0
    said = capfd.readouterr().err
    found = re.search(r"behind (1\.\d+) m nothing is looked at: .* ([0-9]+) % of the light came later", said)
    assert (found is None) == (bins is None)
    if found is not None:
        assert float(found[1]) == pytest.approx(1.10, abs=0.01)
        assert 5 < int(found[2]) < 95


@pytest.mark.parametrize("tail_s", [0.0, 3e-9])
def test_a_tail_that_hides_the_record_is_said_before_there_is_no_light(
    tail_s: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scan = make_raw_scan(hidden_counts=0 if tail_s else 300, delay_s=-12e-9)
    random, counts = np.random.default_rng(3), scan.counts.astype(np.int64)
    time_s = np.arange(counts.shape[1]) * scan.bin_width_s - scan.arrival_bins.ravel()[:, None] * scan.bin_width_s
    if tail_s:
        fades = np.where(time_s > 0, np.exp(-np.maximum(time_s, 0) / tail_s), 0.0)
        counts = counts + random.poisson(20 * fades).reshape(counts.shape)
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file["histograms"] = counts.reshape(16, 16, -1)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = scan.bin_width_s, 2.0
        file.attrs["rectified"] = False
    run(["reconstruct", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "out"), "--method", "lct"])
    said = capfd.readouterr().err
    assert ("direct light fades so slowly" in said) == bool(tail_s)
    assert "of the light came later" not in said
    run(["calibrate", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "constants.h5")])
    assert ("warning: direct light fades so slowly" in capfd.readouterr().err) == bool(tail_s)


@pytest.mark.parametrize("begins", ["before", "amid"])
def test_a_record_that_begins_amid_direct_light_is_told_from_a_wall_that_is_not_plane(
    begins: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scan = make_raw_scan(
        wall_m=1.0, direct_counts=800, hidden_counts=300, delay_s=-12.8e-9, bin_width_s=16e-12, scanner_m=(0, 0, 2.0)
    )
    start = 0 if begins == "before" else int(np.quantile(scan.arrival_bins, 0.4))
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file["histograms"] = scan.counts.reshape(16, 16, -1)[..., start:]
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = scan.bin_width_s, 1.0
        file.attrs["rectified"] = False
    for verb in ("reconstruct", "calibrate"):
        run([verb, str(tmp_path / "raw.h5"), "-o", str(tmp_path / f"{verb}.h5")])
        said = capfd.readouterr().err
        assert ("begins amid direct light" in said) == (begins == "amid"), verb
