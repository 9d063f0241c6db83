"""Real instruments' files: photon totals and histograms are exact, and what is no scan is refused by name."""

from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.picoquant import read_picoquant
from tests.acquisition.importers.ptu_raster import write_raster

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


@pytest.mark.parametrize("two_ways", [False, True])
@pytest.mark.parametrize("sine_percent", [0, 80, 100])
def test_every_photon_of_a_raster_is_at_its_point(tmp_path: Path, two_ways: bool, sine_percent: int) -> None:
    rows, cols, bins = 6, 8, 40
    drawn = np.random.default_rng(0).poisson(0.4, (rows, cols, bins))
    line, point, delay = np.repeat(np.argwhere(drawn >= 0), drawn.ravel(), axis=0).T
    at = point + np.random.default_rng(1).uniform(0.05, 0.95, len(point))  # where the mirror is, 0 to 8
    at = np.where(two_ways & (line % 2 == 1), cols - at, at) / cols
    if sine_percent:
        used = sine_percent / 100
        at = (1 + np.arcsin((2 * at - 1) * used) / np.arcsin(used)) / 2  # when it is there
    photons = np.column_stack([line, at, delay])
    path = write_raster(tmp_path / "a.ptu", (rows, cols), photons, two_ways=two_ways, sine_percent=sine_percent)
    counts = np.moveaxis(read_picoquant(path).transient.counts, 0, 2)
    np.testing.assert_array_equal(counts, drawn[..., : counts.shape[2]])
    assert counts.sum() == drawn.sum()


@pytest.mark.parametrize("sine_percent", [0, 80, 100])
def test_light_at_a_steady_pace_is_even_over_a_line(tmp_path: Path, sine_percent: int) -> None:
    """A mirror that moves as a sine looks at the points at its sides for three times as long."""
    photons = np.column_stack([np.arange(40_000) % 4, np.arange(40_000) / 40_000, np.full(40_000, 5)])
    path = write_raster(tmp_path / "a.ptu", (4, 8), photons, sine_percent=sine_percent)
    scan = read_picoquant(path).transient
    rate = scan.counts.sum(axis=0) / scan.exposure_s
    np.testing.assert_allclose(rate, rate.mean(), rtol=0.02)
    assert scan.exposure_s.sum() == pytest.approx(4 * 8 * 2000 / 10e6)


@pytest.mark.parametrize("name", ["ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame"])
@pytest.mark.parametrize("marker", [-1, 16, 1 << 40])
def test_a_marker_that_no_record_can_hold_is_refused(tmp_path: Path, name: str, marker: int) -> None:
    """`ptufile` computes 2^marker: of 2^40, half a minute and all memory."""
    photons = np.column_stack([np.arange(40) % 4, np.arange(40) / 40, np.full(40, 5)])
    raw = bytearray(write_raster(tmp_path / "a.ptu", (4, 8), photons).read_bytes())
    at = raw.index(name.encode() + b"\0") + 40
    raw[at : at + 8] = marker.to_bytes(8, "little", signed=True)
    (tmp_path / "a.ptu").write_bytes(raw)
    with pytest.raises(InvalidData, match=rf"a\.ptu: states marker {marker} for {name}; there are 1 to 15"):
        read_picoquant(tmp_path / "a.ptu")
