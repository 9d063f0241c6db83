"""Photon-HDF5, as `phconvert` writes it and as its reference lays it out: every photon in its point and bin."""

import gzip
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given

BY_PHCONVERT = Path(__file__).with_name("phconvert_scan.h5.gz")
"""30 points of `kinds_of_files`, counts over 20, as PTU by ptufile 2026.2.6, converted by phconvert 0.10.2."""
TAGS = "user/picoquant/tags"
UNIT_S, BIN_S = 1e-7, 16e-12


@pytest.fixture
def converted(tmp_path: Path) -> Path:
    path = tmp_path / "scan.h5"
    path.write_bytes(gzip.decompress(BY_PHCONVERT.read_bytes()))
    return path


def by_numpy(path: Path) -> np.ndarray:
    """The histograms of the same photons: a line's time in equal parts, in plain steps."""
    with h5py.File(path) as file:
        group = file["photon_data"]
        times, delays, detectors = (group[name][:] for name in ("timestamps", "nanotimes", "detectors"))
        rows, cols = (int(file[f"{TAGS}/ImgHdr_Pix{axis}/value"][()]) for axis in "YX")
    counts = np.zeros((rows, cols, int(delays.max()) + 1))
    for row, (start, stop) in enumerate(zip(times[detectors == 65], times[detectors == 66], strict=True)):
        edges = start + (stop - start) / cols * np.arange(cols + 1)
        for col in range(cols):
            mine = (detectors == 0) & (times >= edges[col]) & (times < edges[col + 1])
            counts[row, col] = np.bincount(delays[mine], minlength=counts.shape[2])
    return counts


def test_a_scan_by_phconvert_has_every_photon_in_its_point_and_bin(converted: Path) -> None:
    scan = read_any(converted)
    assert np.array_equal(np.moveaxis(scan.transient.counts, 0, 2), by_numpy(converted))
    assert float(scan.transient.counts.sum()) == 16_991
    assert scan.transient.time.bin_width_s == pytest.approx(32e-12)
    assert scan.transient.exposure_s == pytest.approx(np.full((6, 5), 200e-6))
    assert not scan.wall_known
    assert not scan.rectified


def test_frames_are_added_up_and_lines_drawn_backwards_are_turned(converted: Path) -> None:
    once = read_any(converted)
    with h5py.File(converted, "r+") as file:
        group = file["photon_data"]
        last = int(group["timestamps"][-1]) + 1
        for name in ("timestamps", "nanotimes", "detectors"):
            twice = np.concatenate([group[name][:], group[name][:] + (last if name == "timestamps" else 0)])
            del group[name]
            group[name] = twice
        file[f"{TAGS}/ImgHdr_BiDirect/value"][()] = 1
    both = read_any(converted).transient
    expected = once.transient.counts.copy()
    expected[:, 1::2] = expected[:, 1::2, ::-1]
    assert np.array_equal(both.counts, 2 * expected)
    assert both.exposure_s == pytest.approx(2 * once.transient.exposure_s)


def test_a_scan_that_was_broken_off_keeps_its_whole_lines(converted: Path) -> None:
    whole = read_any(converted).transient
    with h5py.File(converted, "r+") as file:
        group = file["photon_data"]
        fourth = int(np.flatnonzero(group["detectors"][:] == 65)[3])
        for name in ("timestamps", "nanotimes", "detectors"):
            kept = group[name][: fourth + 40]
            del group[name]
            group[name] = kept
    part = read_any(converted).transient
    assert np.array_equal(part.counts[:, :3], whole.counts[: part.counts.shape[0], :3])
    assert not part.counts[:, 3:].any()
    assert (part.exposure_s[:3] > 0).all()
    assert not part.exposure_s[3:].any()


def write(path: Path, spots: int = 0, **changes: Any) -> Path:
    """Photons as the reference lays them out; `changes`: name in photon_data -> value, None for none."""
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file.attrs.update({"format_name": np.bytes_("Photon-HDF5"), "format_version": np.bytes_("0.5")})
        file["acquisition_duration"] = 2.0
        for spot in range(spots) if spots else ("",):
            values: dict[str, Any] = {
                "timestamps": np.sort(rng.integers(0, 2**40, 500)),
                "nanotimes": rng.integers(0, 512, 500).astype(np.uint16),
                "detectors": np.zeros(500, np.uint8),
                "timestamps_specs/timestamps_unit": UNIT_S,
                "nanotimes_specs/tcspc_unit": BIN_S,
                "nanotimes_specs/tcspc_num_bins": 4096,
            } | changes
            for name, value in values.items():
                if value is not None:
                    file[f"photon_data{spot}/{name}"] = value
    return path


def test_photons_of_one_spot_are_one_histogram(tmp_path: Path) -> None:
    path = write(tmp_path / "one.h5", detectors=np.arange(500).astype(np.uint8) % 2)
    scan = read_any(path)
    with h5py.File(path) as file:
        expected = np.bincount(file["photon_data/nanotimes"][:])
    assert np.array_equal(scan.transient.counts[:, 0, 0], expected)
    assert scan.transient.exposure_s.tolist() == [[2.0]]
    assert any(note.startswith("photons of 2 detectors are added up (0: 250, 1: 250)") for note in scan.notes)


def beside(nanotimes: np.ndarray, count: int, detector: int = 15, delay: int = 0) -> dict[str, Any]:
    """`nanotimes` of two detectors, and `count` records of another between them that all have one delay."""
    rng = np.random.default_rng(1)
    delays = np.concatenate([nanotimes, np.full(count, delay)])
    ids = np.concatenate([1 + np.arange(len(nanotimes)) % 2, np.full(count, detector)])
    order = rng.permutation(len(delays))
    return {
        "timestamps": np.sort(rng.integers(0, 2**40, len(delays))),
        "nanotimes": delays[order].astype(np.uint16),
        "detectors": ids[order].astype(np.uint8),
    }


PHOTONS = np.random.default_rng(2).integers(0, 512, 5000)
"""Delays of which some are 0, as of background."""


@pytest.mark.parametrize("overflows", [16, 13_063])
def test_an_instruments_overflows_are_no_photons(tmp_path: Path, overflows: int) -> None:
    """PicoHarp's, that `phconvert` leaves as a detector 15."""
    scan = read_any(write(tmp_path / "pt3.h5", **beside(PHOTONS, overflows)))
    assert np.array_equal(scan.transient.counts[:, 0, 0], np.bincount(PHOTONS))
    (note,) = (note for note in scan.notes if "not imported, " in note)
    assert f"{overflows:,} of 'detector' 15" in note
    assert "delay 0" in note
    assert "overflows" in note
    assert any("photons of 2 detectors are added up (1: 2,500, 2: 2,500)" in note for note in scan.notes)


def test_a_single_mark_beside_special_records_is_no_photon(tmp_path: Path) -> None:
    """`phconvert` leaves a scan's marks among the photons, a frame's one as a detector 68, where nobody names them."""
    held = beside(PHOTONS, 28, detector=65)
    more = {
        name: np.append(values, values.dtype.type(last))
        for (name, values), last in zip(held.items(), (2**40, 0, 68), strict=True)
    }
    scan = read_any(write(tmp_path / "marks.h5", **more))
    assert np.array_equal(scan.transient.counts[:, 0, 0], np.bincount(PHOTONS))
    assert any("28 of 'detector' 65, 1 of 'detector' 68" in note for note in scan.notes)


def test_an_image_whose_marks_nobody_named_is_refused_with_how_to_name_them(converted: Path) -> None:
    with h5py.File(converted, "r+") as file:
        of_detectors = file["photon_data/measurement_specs/detectors_specs"]
        for name in [name for name in of_detectors if name.startswith("non_photon")]:
            del of_detectors[name]
    with pytest.raises(InvalidData, match=r"nothing is said to be a mark: .* as non_photon_id1 = \[65\]"):
        read_any(converted)


@pytest.mark.parametrize(("count", "delay"), [(15, 0), (5000, 1), (5000, 511)])
def test_photons_that_are_few_at_delay_0_or_all_at_another_stay(tmp_path: Path, count: int, delay: int) -> None:
    scan = read_any(write(tmp_path / "few.h5", **beside(PHOTONS, count, delay=delay)))
    expected = np.bincount(PHOTONS)
    expected[delay] += count
    assert np.array_equal(scan.transient.counts[:, 0, 0], expected)
    assert not any("not imported, " in note for note in scan.notes)
    assert any(f"photons of 3 detectors are added up (1: 2,500, 2: 2,500, 15: {count:,})" in n for n in scan.notes)


@pytest.mark.parametrize("detectors", [None, np.zeros(500, np.uint8), np.arange(500) % 2])
def test_photons_that_all_have_delay_0_are_photons(tmp_path: Path, detectors: np.ndarray | None) -> None:
    scan = read_any(write(tmp_path / "zero.h5", nanotimes=np.zeros(500, np.uint16), detectors=detectors))
    assert scan.transient.counts.ravel().tolist() == [500]


def test_overflows_among_a_scans_photons_leave_its_points_as_they_are(converted: Path) -> None:
    before = read_any(converted).transient
    with h5py.File(converted, "r+") as file:
        group = file["photon_data"]
        times = group["timestamps"][:]
        at = np.linspace(times[0], times[-1], 500).astype(times.dtype)
        for name, more in (("timestamps", at), ("nanotimes", 0 * at), ("detectors", 0 * at + 15)):
            values = np.concatenate([group[name][:], more.astype(group[name].dtype)])
            del group[name]
            group[name] = values[np.argsort(np.concatenate([times, at]), kind="stable")]
    after = read_any(converted)
    assert np.array_equal(after.transient.counts, before.counts)
    assert any("500 of 'detector' 15" in note for note in after.notes)


def note_of_peaks(path: Path, bins: list[int]) -> str:
    """What is said of detectors 3, 4, ... whose photons come in one bin each, of 16 ps, but for one in twenty."""
    rng = np.random.default_rng(3)
    which = np.arange(2000 * len(bins)) % len(bins)
    delays = np.where(rng.random(len(which)) < 0.05, rng.integers(0, 512, len(which)), np.array(bins)[which])
    times = np.sort(rng.integers(0, 2**40, len(which)))
    scan = read_any(write(path, timestamps=times, nanotimes=delays, detectors=(which + 3).astype(np.uint8)))
    assert scan.transient.counts.sum() == len(which)
    return next((note for note in scan.notes if "added up" in note), "")


def test_what_is_added_up_names_detectors_and_how_far_apart_they_lie(tmp_path: Path) -> None:
    path = tmp_path / "cables.h5"
    assert "peaks" not in note_of_peaks(path, [100, 101])
    said = note_of_peaks(path, [100, 112, 105])
    assert "photons of 3 detectors are added up (3: 2,000, 4: 2,000, 5: 2,000)" in said
    assert "192 ps apart" in said
    assert "10: 2,000" in note_of_peaks(path, [100] * 8)
    said = note_of_peaks(path, [100] * 9)
    assert "photons of 9 detectors are added up" in said
    assert "2,000" not in said
    assert not note_of_peaks(path, [100])


def test_spots_say_which_of_their_detectors_are_added_up(tmp_path: Path) -> None:
    scan = read_any(write(tmp_path / "few.h5", spots=3, **beside(PHOTONS, 100)))
    for spot in range(3):
        assert np.array_equal(scan.transient.counts[:, 0, spot], np.bincount(PHOTONS))
        assert sum(f"spot {spot}: photons of 2 detectors are added up (1: 2,500" in note for note in scan.notes) == 1
        assert sum(f"spot {spot}: records that all have delay 0" in note for note in scan.notes) == 1
    many = read_any(write(tmp_path / "many.h5", spots=40, detectors=np.arange(500) % 2))
    assert len(many.notes) < 15
    assert any("32 more notes" in note for note in many.notes)


def test_several_spots_are_a_row_of_points(tmp_path: Path) -> None:
    path = write(tmp_path / "spots.h5", spots=3)
    scan = read_any(path)
    with h5py.File(path) as file:
        for spot in range(3):
            expected = np.bincount(file[f"photon_data{spot}/nanotimes"][:], minlength=scan.transient.time.bins)
            assert np.array_equal(scan.transient.counts[:, 0, spot], expected)


def test_a_spot_without_photons_takes_no_others_with_it(tmp_path: Path) -> None:
    path = write(tmp_path / "spots.h5", spots=4)
    with h5py.File(path, "r+") as file:
        del file["photon_data1"]
        kept = [np.bincount(file[f"photon_data{spot}/nanotimes"][:], minlength=512) for spot in (0, 2, 3)]
    scan = read_any(path)
    counts = scan.transient.counts[:, 0].T
    assert np.array_equal(counts[[0, 2, 3]], np.stack(kept)[:, : counts.shape[1]])
    assert scan.transient.exposure_s.tolist() == [[2.0, 0.0, 2.0, 2.0]]
    assert "1 of 4 spots have no group of photons: not measured" in scan.notes


def test_what_the_file_does_not_say_the_user_says(tmp_path: Path) -> None:
    path = write(tmp_path / "one.h5", **{"nanotimes_specs/tcspc_unit": None})
    with pytest.raises(InvalidData, match=r"tcspc_unit.*--bin-width-ps"):
        read_any(path)
    assert read_any(path, Given(bin_width_s=BIN_S)).transient.time.bin_width_s == BIN_S


MARKS = "measurement_specs/detectors_specs/non_photon_id1"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"nanotimes": None}, "nanotimes: is missing: photons without their delay"),
        ({"nanotimes": np.zeros(400, np.uint16)}, "400 nanotimes"),
        ({"nanotimes": np.full(500, 5000)}, "beyond its 4096 bins"),
        ({"nanotimes": np.zeros(500)}, "whole numbers"),
        ({"timestamps_specs/timestamps_unit": None}, "timestamps_unit"),
        ({"detectors": np.arange(500) % 3, MARKS: np.array([2])}, "166 marks, and nothing says how they divide"),
        ({"detectors": np.full(500, 2), MARKS: np.array([2])}, "holds no photons"),
    ],
)
def test_what_makes_no_histograms_is_refused_by_name(tmp_path: Path, changes: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidData, match=f"one.h5.*{named}"):
        read_any(write(tmp_path / "one.h5", **changes))


@pytest.mark.parametrize(
    ("tag", "value", "named"),
    [("ImgHdr_PixX", 0, "0 points"), ("ImgHdr_PixY", 4, "6 marked lines in a frame; its tags state 4"),
     ("ImgHdr_LineStop", 77, "marks at inputs"), ("ImgHdr_SinCorrection", 80, "resonant"),
     ("ImgHdr_LineStart", 4, "0 marked lines")],
)  # fmt: skip
def test_an_image_whose_tags_do_not_fit_is_refused(converted: Path, tag: str, value: int, named: str) -> None:
    with h5py.File(converted, "r+") as file:
        file[f"{TAGS}/{tag}/value"][()] = value
    with pytest.raises(InvalidData, match=named):
        read_any(converted)


@pytest.mark.parametrize("keep", [100, 3000, 60_000, -1])
def test_truncated_files_are_refused(converted: Path, keep: int) -> None:
    converted.write_bytes(converted.read_bytes()[:keep])
    with pytest.raises(InvalidData, match=r"scan\.h5"):
        read_any(converted)
