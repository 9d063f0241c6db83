"""Real instruments' files: photon totals and histograms are exact, and what is no scan is refused by name."""

import struct
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.picoquant import read_picoquant
from nlos.drivers.tcspc.t3 import FORMATS, T3Decoder
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
    with pytest.raises(InvalidData, match="is no file of PicoQuant's"):
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


@needs_files
@pytest.mark.parametrize(
    ("name", "took_s"),
    [("picoharp_topfluorPE.pt3", 11.08), ("timeharp_v50.t3r", 9.344), ("hydraharp_v20.ht3", 10.0)],
)
def test_the_exposure_is_what_the_measurement_took_not_what_was_asked_for(name: str, took_s: float) -> None:
    scan = read_picoquant(TCSPC / name)
    assert scan.transient.exposure_s == pytest.approx(np.full((1, 1), took_s))


@needs_files
@pytest.mark.parametrize(("stopped_ms", "took_s"), [(4_321, 4.321), (0, 10.0)])
def test_the_exposure_of_a_curve_that_was_stopped_early_is_what_it_took(
    tmp_path: Path, stopped_ms: int, took_s: float
) -> None:
    """PicoHarp 300 manual, .phd: Channels, AcqTime and StopAfter follow one another in a curve's header."""
    data = (TCSPC / "picoharp_v20.phd").read_bytes()
    stored, other = (struct.pack("<3i", 65_536, 10_000, after) for after in (10_000, stopped_ms))
    assert data.count(stored) == 1
    (tmp_path / "a.phd").write_bytes(data.replace(stored, other))
    assert read_picoquant(tmp_path / "a.phd").transient.exposure_s[0, :2] == pytest.approx([took_s, 1800.0])


@needs_files
@pytest.mark.parametrize("width_ns", [0.075, 0.08])  # 6.8 and 6.4 of them make 512 ps
def test_curves_whose_bins_do_not_fit_into_each_other_are_refused(tmp_path: Path, width_ns: float) -> None:
    data = (TCSPC / "picoharp_v20.phd").read_bytes()
    (tmp_path / "a.phd").write_bytes(data.replace(struct.pack("<f", 0.128), struct.pack("<f", width_ns)))
    with pytest.raises(InvalidData, match=r"histogram 0: .* s bins do not fit 5\.12e-10 s"):
        read_picoquant(tmp_path / "a.phd")


@needs_files
def test_detectors_that_are_added_up_are_named_with_their_photons() -> None:
    scan = read_picoquant(TCSPC / "picoharp_topfluorPE.pt3")
    assert (
        "photons of 2 detectors are added up (1: 482,775, 2: 490,562); their peaks lie up to 96 ps apart; "
        "--detector N takes one alone" in scan.notes
    )


@needs_files
def test_a_timeharps_delays_run_from_the_laser_pulse() -> None:
    """It counts from the photon to the next pulse: a decay would rise."""
    counts = read_picoquant(TCSPC / "timeharp_v50.t3r").transient.counts.ravel()
    peak = int(counts.argmax())
    assert counts[peak : peak + 600].sum() > 2 * counts[peak - 600 : peak].sum()


@needs_files
@pytest.mark.parametrize("suffix", [".dat", "", ".phd", ".thd", ".mat"])
def test_a_file_is_known_by_its_contents(tmp_path: Path, suffix: str) -> None:
    whole = TCSPC / "picoharp_topfluorPE.pt3"
    (tmp_path / f"a{suffix}").write_bytes(whole.read_bytes())
    read, expected = read_any(tmp_path / f"a{suffix}"), read_picoquant(whole)
    assert read.source_format == "PicoHarp PT3"
    assert np.array_equal(read.transient.counts, expected.transient.counts)


@needs_files
def test_a_ptu_image_has_its_dwell_from_line_markers_where_it_is_not_stored() -> None:
    scan = read_picoquant(TCSPC / "picoharp_t3_image_hazelnut_frame1.ptu")
    assert scan.transient.exposure_s[0, 0] == pytest.approx(6.33e-6, rel=1e-2)
    assert any("6.332 µs a point and frame by its line markers" in note for note in scan.notes)


def raster(path: Path) -> bytearray:
    photons = np.column_stack([np.arange(400) % 4, np.arange(400) / 400, np.full(400, 5)])
    return bytearray(write_raster(path, (4, 8), photons).read_bytes())


def tagged(raw: bytearray, name: str, value: int) -> bytearray:
    at = raw.index(name.encode() + b"\0") + 40
    raw[at : at + 8] = value.to_bytes(8, "little", signed=True)
    return raw


@pytest.mark.parametrize("short", [4, 40, 800])
def test_a_ptu_that_is_cut_off_is_refused(tmp_path: Path, short: int) -> None:
    """The part that is missing would be points that were measured and dark."""
    raw = raster(tmp_path / "a.ptu")
    (tmp_path / "a.ptu").write_bytes(raw[:-short])
    with pytest.raises(InvalidData, match=r"a\.ptu: is cut off: its header states \d+ records, \d+ are there"):
        read_picoquant(tmp_path / "a.ptu")


def test_a_ptu_that_was_broken_off_is_read_and_says_so(tmp_path: Path) -> None:
    raw = raster(tmp_path / "a.ptu")
    (tmp_path / "b.ptu").write_bytes(tagged(raw, "TTResult_NumberOfRecords", 0))
    scan, whole = read_picoquant(tmp_path / "b.ptu"), read_picoquant(tmp_path / "a.ptu")
    assert np.array_equal(scan.transient.counts, whole.transient.counts)
    assert any("its header states no records" in note for note in scan.notes)


@pytest.mark.parametrize("astray", [0, 1, 3])
def test_photons_between_the_lines_of_a_ptu_image_are_counted_and_told(tmp_path: Path, astray: int) -> None:
    inside = np.column_stack([np.arange(40) % 4, (np.arange(40) + 0.5) / 40, np.full(40, 5)])
    between = np.column_stack([np.arange(astray), np.full(astray, 1.01), np.full(astray, 5)])
    scan = read_picoquant(write_raster(tmp_path / "a.ptu", (4, 8), np.vstack([inside, between])))
    assert scan.transient.counts.sum() == 40
    said = [note for note in scan.notes if "are not imported" in note]
    assert [note.partition(" photons,")[0] for note in said] == ([f"{astray} of {40 + astray}"] if astray else [])


def test_a_ptu_image_whose_photons_all_lie_between_lines_is_refused(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.ptu", (4, 8), np.array([[0, 1.01, 5], [1, 1.01, 5]]))
    with pytest.raises(InvalidData, match=r"a\.ptu: none of its 2 photons lies within a line"):
        read_picoquant(path)


def test_a_ptu_image_whose_photons_find_no_line_is_refused(tmp_path: Path) -> None:
    """Abberior's Imspector counts markers from 0: such files came out black, and complete."""
    raw = raster(tmp_path / "a.ptu")
    (tmp_path / "a.ptu").write_bytes(tagged(raw, "ImgHdr_LineStart", 0))
    with pytest.raises(InvalidData, match=r"a\.ptu: none of its 400 photons lies within a line .*LineStart 0"):
        read_picoquant(tmp_path / "a.ptu")


def test_a_ptu_image_without_photons_is_called_one(tmp_path: Path) -> None:
    write_raster(tmp_path / "dark.ptu", (4, 8), np.zeros((0, 3)))
    with pytest.raises(InvalidData, match=r"dark\.ptu: holds no photons"):
        read_picoquant(tmp_path / "dark.ptu")


def test_a_ptu_image_that_does_not_say_its_size_is_refused_by_that(tmp_path: Path) -> None:
    raw = raster(tmp_path / "a.ptu").replace(b"ImgHdr_PixY\0", b"Other_Words\0")
    (tmp_path / "a.ptu").write_bytes(raw)
    with pytest.raises(InvalidData, match=r"a\.ptu: does not say .* its header lacks ImgHdr_PixY\. Store it again"):
        read_picoquant(tmp_path / "a.ptu")


def test_a_git_lfs_pointer_is_called_one(tmp_path: Path) -> None:
    for name in ("a.ptu", "a.mat", "a.h5", "a.npz", "a.sdt"):
        (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 5\n")
        with pytest.raises(InvalidData, match=r"is a pointer of Git LFS, not the file. Get that with `git lfs pull`"):
            read_any(tmp_path / name)


def timeharp(version: str, curves: list[np.ndarray] | None, records: np.ndarray | None = None) -> bytes:
    """A TimeHarp 200 file after the vendor's structures: histograms, or records."""
    head = b"TimeHarp 200".ljust(16, b"\0") + version.encode().ljust(6, b"\0")
    head = head.ljust(328 if version == "6.0" else 304, b"\0")
    mode = 0 if records is None else 2
    head += struct.pack("<11i I 7i", 4096, len(curves or []), 32, 1, 1, 0, mode, 0, 1, 0, 60_000, *[0] * 8)
    head += bytes(136) + (bytes(24) if version == "6.0" else b"") + struct.pack("<5i f", *[0] * 5, 0.07)
    for number, counts in enumerate(curves or []):
        said = [
            number,
            *[0] * 9,
            0.0,
            0.0,
            0.0,
            1,
            0,
            60_000,
            2_500 + number,
            1,
            0,
            0,
            0,
            int(counts.sum()),
            0.07,
            0,
            0,
        ]
        head += struct.pack("<10i 3f 9i f 2i", *said) + counts.astype("<u4").tobytes()
    if records is not None:
        head += struct.pack("<13i", *[0] * 9, 1_500, 1, len(records), 0) + records.astype("<u4").tobytes()
    return head


@pytest.mark.parametrize("version", ["2.0", "3.0", "5.0", "6.0"])
def test_a_timeharps_histograms_are_a_row_of_points(tmp_path: Path, version: str) -> None:
    curves = [np.random.default_rng(n).poisson(2.0, 4096) for n in range(3)]
    (tmp_path / "a.thd").write_bytes(timeharp(version, curves))
    scan = read_any(tmp_path / "a.thd").transient
    assert np.array_equal(scan.counts[:, 0], np.stack(curves, axis=1))
    assert scan.exposure_s == pytest.approx(np.array([[2.5, 2.501, 2.502]]))
    assert scan.time.bin_width_s == pytest.approx(70e-12)
    (tmp_path / "a.thd").write_bytes(timeharp(version, curves)[:-100])
    with pytest.raises(InvalidData, match="is cut off: histogram 2 of 3"):
        read_any(tmp_path / "a.thd")


@pytest.mark.parametrize("version", ["5.0", "6.0"])
def test_a_timeharps_records_are_one_point(tmp_path: Path, version: str) -> None:
    delays = np.array([100, 100, 2000, 4095])
    records = (1 << 30) | (delays << 16) | 7
    (tmp_path / "a.t3r").write_bytes(timeharp(version, None, np.append(records, 1 << 31)))
    scan = read_any(tmp_path / "a.t3r").transient
    assert {int(at): int(scan.counts[at, 0, 0]) for at in np.flatnonzero(scan.counts)} == {0: 1, 2095: 1, 3995: 2}
    assert scan.exposure_s[0, 0] == pytest.approx(1.5)


@needs_files
def test_a_picoharp_that_divides_its_sync_still_counts_every_laser_pulse() -> None:
    """Measured with divider 8 at 78 MHz (both in the header): so a T3 scan may divide, and dwells are laser pulses."""
    whole = (TCSPC / "picoharp_topfluorPE.pt3").read_bytes()
    (divider,), (resolution_ns,) = struct.unpack("<i", whole[564:568]), struct.unpack("<f", whole[584:588])
    (sync_hz,), (stopped_ms,) = struct.unpack("<i", whole[704:708]), struct.unpack("<i", whole[712:716])
    records = np.frombuffer(whole[728:], "<u4")
    events = T3Decoder(FORMATS[0x00010303]).feed(records)
    assert divider == 8
    assert events.until_pulse / sync_hz == pytest.approx(stopped_ms * 1e-3, rel=0.02)
    delays_ns = events.format.delays(events.photons) * resolution_ns
    assert 0.9 < delays_ns.max() * 1e-9 * sync_hz < 1.02, "later than the last laser pulse, not than the last eighth"
