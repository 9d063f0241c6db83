"""A scan as PTU: every photon in its point and bin and the exposure, however long or uneven, by our reader and others'.

What every exporter promises is in `test_every_exporter.py`; other programs read PTU in `tests/peers`.
"""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import ptufile
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters import ptu
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid

BIN_S = 32e-12
Counts = npt.NDArray[np.uint32]


def scan(counts: Counts, exposure_s: npt.NDArray[np.float64] | float, bin_width_s: float = BIN_S) -> ScanArrays:
    rows, cols, bins = counts.shape
    wall = WallGrid(1.2, 0.9, rows, cols)
    exposure = np.broadcast_to(np.asarray(exposure_s, np.float64), (rows, cols))
    return ScanArrays(counts, exposure, wall.x_m(), wall.y_m(), wall, TimeAxis(bins, bin_width_s))


def drawn(rate: float, shape: tuple[int, int, int] = (5, 7, 300)) -> Counts:
    counts = np.random.default_rng(4).poisson(rate, shape).astype(np.uint32)
    counts[-1, -1, -1] += 1  # a PTU does not say how many empty bins follow
    return counts


def check_read_back(path: Path, counts: Counts, exposure_s: float) -> None:
    """By our importer, by ptufile's image, and by laser pulses and line markers alone."""
    back = read_any(path).transient
    assert np.array_equal(np.moveaxis(back.counts, 0, 2), counts)
    assert back.exposure_s == pytest.approx(np.full(counts.shape[:2], exposure_s), rel=1e-9)
    rows, cols, _ = counts.shape
    with ptufile.PtuFile(path) as file:
        image = file.decode_image(frame=-1, channel=-1, dtype=np.uint32, keepdims=False)
        records = file.decode_records()
        assert file.pixel_time == pytest.approx(exposure_s, rel=1e-9)
        assert file.acquisition_time == pytest.approx(rows * cols * exposure_s, rel=1e-9)
        assert file.tags["ImgHdr_TimePerPixel"] == pytest.approx(exposure_s * 1e3, rel=1e-12)
        assert file.number_records * 4 + file.record_offset == path.stat().st_size
        assert (file.shape[0], file.tags["ImgHdr_MaxFrames"]) == (1, 1)
        assert file.number_bins_in_period >= counts.shape[2]
    assert np.array_equal(image.reshape(counts.shape), counts)
    records = records[(records["channel"] >= 0) | (records["marker"] > 0)]  # the others are overflows
    photons, pulses = records[records["channel"] >= 0], records["time"].astype(np.int64)
    begins, ends = (pulses[records["marker"] == bit] for bit in (1, 2))
    assert len(begins) == len(ends) == rows
    assert np.array_equal(pulses[records["marker"] == 4], ends[-1:])
    assert (np.diff(pulses) >= 0).all()
    row = np.searchsorted(begins, photons["time"].astype(np.int64), side="right") - 1
    col = (photons["time"].astype(np.int64) - begins[row]) * cols // (ends - begins)[row]
    again = np.zeros_like(counts)
    np.add.at(again, (row, col, photons["dtime"]), 1)
    assert np.array_equal(again, counts)


@pytest.mark.parametrize("rate", [0.001, 0.3, 40.0])
@pytest.mark.parametrize("exposure_s", [2.5e-7, 1e-3, 0.0151234567, 1.0, 3600.0, 1e6])
def test_photons_and_exposures_come_back(tmp_path: Path, rate: float, exposure_s: float) -> None:
    counts = drawn(rate)
    notes = write_ptu(scan(counts, exposure_s), tmp_path / "scan.ptu")
    check_read_back(tmp_path / "scan.ptu", counts, exposure_s)
    assert not any("exposure" in note for note in notes)
    shared = int((counts.sum(axis=2) > exposure_s / 100e-9).sum())
    assert any(note.startswith(f"{shared} of 35 points have more photons") for note in notes) == (shared > 0)


@pytest.mark.parametrize("shape", [(1, 1, 50), (1, 300, 20), (3000, 1, 4), (2, 3, 32_768)])
def test_any_shape_comes_back(tmp_path: Path, shape: tuple[int, int, int]) -> None:
    counts = drawn(0.1, shape)
    write_ptu(scan(counts, 0.02), tmp_path / "scan.ptu")
    check_read_back(tmp_path / "scan.ptu", counts, 0.02)


@pytest.mark.parametrize("rectified", [True, False])
def test_delays_count_from_time_0_where_the_record_begins_later(tmp_path: Path, rectified: bool) -> None:
    counts = drawn(0.3)
    late = replace(scan(counts, 1.0), time=TimeAxis(300, BIN_S, 100 * BIN_S), rectified=rectified)
    notes = write_ptu(late, tmp_path / "late.ptu")
    check_read_back(tmp_path / "late.ptu", np.pad(counts, ((0, 0), (0, 0), (100, 0))), 1.0)
    assert not any("delays" in note for note in notes)
    between = replace(late, time=TimeAxis(300, BIN_S, 100.25 * BIN_S))
    assert "delays are whole bins: times are 8 ps off" in write_ptu(between, tmp_path / "between.ptu")


def test_what_begins_too_late_for_a_record_is_refused_unless_its_light_tells_its_time(tmp_path: Path) -> None:
    counts = drawn(0.3)
    late = replace(scan(counts, 1.0), time=TimeAxis(300, BIN_S, 32_500 * BIN_S))
    with pytest.raises(InvalidData, match="its 300 bins begin 1040 ns after time 0, at bin 32500"):
        write_ptu(replace(late, rectified=True), tmp_path / "late.ptu")
    assert any("delays count from the first bin" in note for note in write_ptu(late, tmp_path / "late.ptu"))
    check_read_back(tmp_path / "late.ptu", counts, 1.0)


@pytest.mark.parametrize("block", [1, 7, 64])
def test_pieces_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    """Records are made in pieces; here of few photons, which end anywhere in a line, a point or a bin."""
    counts = drawn(0.5, (3, 4, 30))
    write_ptu(scan(counts, 0.5), tmp_path / "whole.ptu")
    monkeypatch.setattr(ptu, "_BLOCK", block)
    write_ptu(scan(counts, 0.5), tmp_path / "pieces.ptu")
    check_read_back(tmp_path / "pieces.ptu", counts, 0.5)
    whole, pieces = (ptufile.PtuFile(tmp_path / name) for name in ("whole.ptu", "pieces.ptu"))
    with whole, pieces:
        assert np.array_equal(whole.read_records(), pieces.read_records())


def test_hours_with_few_photons_take_a_second_and_few_bytes(tmp_path: Path) -> None:
    """18 hours: 655,360,000,000 laser pulses, of which 33,000 have a photon."""
    counts = drawn(0.002, (256, 256, 256))
    begun = time.process_time()
    write_ptu(scan(counts, 1.0), tmp_path / "scan.ptu")
    assert time.process_time() - begun < 3.0  # 0.2 s on an idle core
    assert (tmp_path / "scan.ptu").stat().st_size < 4 << 20
    check_read_back(tmp_path / "scan.ptu", counts, 1.0)


def test_one_bright_point_makes_no_others_long(tmp_path: Path) -> None:
    counts = drawn(0.01, (64, 64, 128))
    counts[20, 30, 40] = 3_000_000
    write_ptu(scan(counts, 0.1), tmp_path / "scan.ptu")
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
        assert file.number_records < 2 * counts.sum()
        assert file.global_resolution == pytest.approx(100e-9)
    check_read_back(tmp_path / "scan.ptu", counts, 0.1)


def test_pulses_lie_further_apart_where_delays_or_exposures_are_long(tmp_path: Path) -> None:
    counts = drawn(0.1)
    for bin_width_s, exposure_s, period_s in (
        (BIN_S, 1.0, 100e-9),
        (1e-9, 301e-9 * 64, 301e-9),
        (1e-9, 1.0, 301e-9),
        (BIN_S, 1e7, 79.6e-6),
    ):
        notes = write_ptu(scan(counts, exposure_s, bin_width_s), tmp_path / "scan.ptu")
        with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
            assert file.global_resolution == pytest.approx(period_s, rel=1e-3)
            assert file.number_records < counts.sum() + (5 << 20)
        assert any("laser's period is not known" in note for note in notes)
        check_read_back(tmp_path / "scan.ptu", counts, exposure_s)


def test_uneven_exposures_become_their_mean_and_are_named(tmp_path: Path) -> None:
    counts, exposure_s = drawn(0.3), np.random.default_rng(5).uniform(0.01, 0.02, (5, 7))
    exposure_s[0, 0], exposure_s[1, 1] = 0.01, 0.02
    notes = write_ptu(scan(counts, exposure_s), tmp_path / "scan.ptu")
    check_read_back(tmp_path / "scan.ptu", counts, float(exposure_s.mean()))
    assert any("exposures differ, 0.01 to 0.02 s" in note and f"{exposure_s.mean():g} s" in note for note in notes)


def test_points_that_were_not_measured_are_named_and_leave_the_others_exposure(tmp_path: Path) -> None:
    counts, exposure_s = drawn(0.3), np.full((5, 7), 0.04)
    counts[2], exposure_s[2] = 0, 0.0
    notes = write_ptu(scan(counts, exposure_s), tmp_path / "scan.ptu")
    check_read_back(tmp_path / "scan.ptu", counts, 0.04)
    assert any("7 of 35 points were not measured" in note for note in notes)
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:  # of the points that were: the vendor states it in ms
        assert file.tags["MeasDesc_AcquisitionTime"] == 28 * 40
    assert not any("differ" in note for note in notes)


@pytest.mark.parametrize(("laser_s", "said"), [(12.5e-9, False), (8e-9, True), (50e-9, False), (None, True)])
def test_pulses_are_as_far_apart_as_they_were(tmp_path: Path, laser_s: float | None, said: bool) -> None:
    """Where delays fit between them: 300 bins take 9.6 ns."""
    held = replace(scan(drawn(0.3), 1e-3, 32e-12), laser_period_s=laser_s)
    notes = write_ptu(held, tmp_path / "scan.ptu")
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
        expected_s = max(laser_s or 100e-9, 301 * 32e-12)
        assert file.tags["MeasDesc_GlobalResolution"] == pytest.approx(expected_s, rel=1e-4)
    assert any("the laser's period" in note for note in notes) == said
    check_read_back(tmp_path / "scan.ptu", held.histograms, 1e-3)


def test_bins_after_the_last_photon_are_named(tmp_path: Path) -> None:
    counts = drawn(0.3)
    counts[:, :, -20:] = 0
    counts[3, 4, -21] = 1
    assert any("the last 20 bins hold no photon" in note for note in write_ptu(scan(counts, 1e-3), tmp_path / "a.ptu"))
    counts[0, 0, -1] = 1
    assert not any("hold no photon" in note for note in write_ptu(scan(counts, 1e-3), tmp_path / "b.ptu"))


def test_an_exposure_below_a_laser_period_is_named(tmp_path: Path) -> None:
    counts = drawn(0.3)
    notes = write_ptu(scan(counts, 1e-9), tmp_path / "scan.ptu")
    check_read_back(tmp_path / "scan.ptu", counts, 100e-9)
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
        assert file.tags["MeasDesc_AcquisitionTime"] == 1  # 0 ms would be no measurement
    assert any("exposures of 1e-09 s are below a laser period: 1e-07 s is written" in note for note in notes)


@pytest.mark.parametrize(
    ("counts", "exposure_s", "named"),
    [
        (np.full((2, 2, 4), 1 << 28, np.uint32), 1.0, r"4,294,967,296 photons.*16\.0 GiB.*Export npz"),
        (np.ones((1, 2, 32_769), np.uint32), 1.0, "32769 bins.*Rebin"),
        (np.zeros((2, 2, 4), np.uint32), 0.0, "no point of the scan was measured"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    tmp_path: Path, counts: Counts, exposure_s: float, named: str
) -> None:
    path = tmp_path / "scan.ptu"
    path.write_bytes(b"older")
    with pytest.raises(InvalidData, match=rf"scan\.ptu: {named}"):
        write_ptu(scan(counts, exposure_s), path)
    assert path.read_bytes() == b"older"


def test_a_scan_without_photons_is_written(tmp_path: Path) -> None:
    dark = replace(scan(drawn(0.1), 0.5), histograms=np.zeros((5, 7, 300), np.uint32))
    write_ptu(dark, tmp_path / "scan.ptu")
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
        assert (file.number_photons, file.number_lines) == (0, 5)
        assert file.pixel_time == pytest.approx(0.5)
