"""Real instruments' files: photon totals and histograms are exact, and what is no scan is refused by name."""

from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.picoquant import read_picoquant

TCSPC = Path(__file__).parents[4] / "shared" / "data" / "tcspc"
needs_files = pytest.mark.skipif(not TCSPC.is_dir(), reason="the measured TCSPC files are not beside the repository")


@needs_files
def test_a_ptu_scan_equals_its_expected_histograms() -> None:
    scan = read_picoquant(TCSPC / "replay_s_u.ptu")
    expected = np.load(TCSPC / "replay_s_u_expected.npz")["histograms"]
    assert np.array_equal(scan.transient.counts, np.moveaxis(expected, 2, 0))
    assert scan.transient.time.bin_width_s == pytest.approx(4e-12)
    assert scan.transient.exposure_s[0, 0] == pytest.approx(14.62e-6)


@needs_files
def test_a_ptu_image_equals_its_expected_decode() -> None:
    scan = read_picoquant(TCSPC / "picoharp_t3_image_hazelnut_frame1.ptu")
    expected = np.load(TCSPC / "picoharp_t3_image_hazelnut_frame1_expected.npz")
    assert np.array_equal(scan.transient.counts.sum(axis=0), expected["image_counts"])
    assert np.array_equal(scan.transient.counts.sum(axis=(1, 2)), expected["histogram"])


@needs_files
@pytest.mark.parametrize(
    ("name", "points", "bin_width_s"),
    [
        ("picoharp_topfluorPE.pt3", 1, 16e-12),
        ("hydraharp_v20.ht3", 1, 16e-12),
        ("timeharp_v50.t3r", 1, 70.237e-12),
        ("picoharp_v20.phd", 7, 512e-12),
    ],
)
def test_older_files_arrive_as_points(name: str, points: int, bin_width_s: float) -> None:
    scan = read_picoquant(TCSPC / name)
    assert scan.transient.exposure_s.shape == (1, points)
    assert scan.transient.time.bin_width_s == pytest.approx(bin_width_s, rel=1e-4)
    assert (scan.transient.counts.sum(axis=0) > 0).all()


@needs_files
def test_every_photon_record_is_counted() -> None:
    raw = np.frombuffer((TCSPC / "picoharp_topfluorPE.pt3").read_bytes()[728:], "<u4")
    scan = read_picoquant(TCSPC / "picoharp_topfluorPE.pt3")
    assert int(scan.transient.counts.sum()) == int((raw >> 28 != 15).sum())


@needs_files
def test_t2_has_no_delay_times_and_is_refused() -> None:
    with pytest.raises(InvalidData, match="T2"):
        read_picoquant(TCSPC / "hydraharp_v30_t2.ptu")


@needs_files
@pytest.mark.parametrize("name", ["picoharp_topfluorPE.pt3", "hydraharp_v20.ht3", "timeharp_v50.t3r"])
@pytest.mark.parametrize("keep", [0, 10, 330, 600, 727, 5000])
def test_truncated_files_are_refused(name: str, keep: int, tmp_path: Path) -> None:
    short = tmp_path / name
    short.write_bytes((TCSPC / name).read_bytes()[:keep])
    with pytest.raises(InvalidData, match=name.replace(".", r"\.")):
        read_picoquant(short)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.ptu"
    path.write_bytes(b"x" * 500)
    with pytest.raises(InvalidData, match="not read"):
        read_picoquant(path)
