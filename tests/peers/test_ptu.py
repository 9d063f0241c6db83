"""Recordings as PTU, and any T3 records: vendor's library, phconvert and ptufile find the photons and markers we do."""

import os
import struct
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import ptufile
import pytest

from nlos.__main__ import run
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.recording.recording import Recording
from nlos.drivers.tcspc.t3 import FORMATS, T3Decoder

SCAN = """
wall: {width_m: 0.8, height_m: 0.6, rows: 12, cols: 16}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 512, bin_width_ps: WIDTH, offset_ns: 8}
"""
BENCHES = {"simulated": 32, "multiharp": 40, "optotune": 32}
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Found:
    """What a reader makes of the records: photons and markers, each in the order of the file."""

    photons: Integers  # (n, 3) laser pulse, delay, channel
    markers: Integers  # (m, 2) laser pulse, bits

    @classmethod
    def of(cls, pulse: Any, delay: Any, channel: Any, marker: Any) -> "Found":
        is_marker = np.asarray(marker) != 0
        events = np.stack([np.asarray(each, np.int64) for each in (pulse, delay, channel, marker)], axis=1)
        return cls(events[~is_marker][:, :3], events[is_marker][:, [0, 3]])

    def same(self, other: "Found") -> bool:
        return np.array_equal(self.photons, other.photons) and np.array_equal(self.markers, other.markers)


def by_us(path: Path) -> Found:
    with ptufile.PtuFile(path) as file:
        layout, records = FORMATS[int(file.record_type)], file.read_records()
    events = T3Decoder(layout).feed(records)
    delays, channels = layout.delays(events.photons), layout.channels(events.photons)
    photons = np.stack([events.photon_pulses, delays.astype(np.int64), channels.astype(np.int64)], axis=1)
    return Found(photons, np.stack([events.marker_pulses, events.marker_bits.astype(np.int64)], axis=1))


def records_of(path: Path) -> npt.NDArray[np.uint32]:
    with ptufile.PtuFile(path) as file:
        return np.asarray(file.read_records())


def by_ptufile(path: Path) -> Found:
    with ptufile.PtuFile(path) as file:
        records = file.decode_records()
    records = records[(records["channel"] >= 0) | (records["marker"] > 0)]  # the others are overflows
    return Found.of(records["time"], records["dtime"], records["channel"], records["marker"])


@pytest.fixture
def foreign(foreign_python: Callable[..., Path], tmp_path: Path) -> Callable[[str, Path], dict[str, Any]]:
    """foreign("snapi", path): what the vendor's library, or phconvert, finds."""

    def read(reader: str, path: Path) -> dict[str, Any]:
        python = foreign_python({"snapi": "snAPI"}.get(reader, reader))
        script = Path(__file__).parent / "picoquant" / "read_ptu.py"
        done = subprocess.run(
            [python, script, reader, path, tmp_path / "found.npz"],
            capture_output=True,
            timeout=240,
            env={**os.environ, "HOME": str(tmp_path)},  # the vendor's library keeps its log there
        )
        said = (done.stdout + done.stderr).decode("utf-8", "replace")
        assert done.returncode == 0, said
        assert " ERR " not in said
        assert " WRN " not in said
        with np.load(tmp_path / "found.npz") as found:
            return dict(found)

    return read


def found_by(fields: dict[str, Any]) -> Found:
    return Found.of(fields["pulse"], fields["delay"], fields["channel"], fields["marker"])


@pytest.fixture(params=BENCHES)
def exported(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Recording, Path]]:
    """A scan as the command line records and exports it."""
    scan, recording, ptu = tmp_path / "scan.yaml", tmp_path / "run.h5", tmp_path / "run.ptu"
    scan.write_text(SCAN.replace("WIDTH", str(BENCHES[request.param])), "utf-8")
    assert run(["scan", str(scan), "--bench", request.param, "-o", str(recording)]) == 0
    assert run(["export", str(recording), "--to", "ptu", "-o", str(ptu)]) == 0
    with Recording.open(recording) as opened:
        yield opened, ptu


def from_time_0(recording: Recording) -> npt.NDArray[np.float32]:
    """Its counts (T, H, W) after the bins before the first, which is where a PTU's delays count from."""
    counts, axis = recording.transient().counts, recording.plan.axis
    return np.pad(counts, ((round(axis.offset_s / axis.bin_width_s), 0), (0, 0), (0, 0)))


def test_a_recordings_photons_and_markers_are_found_by_every_reader(
    exported: tuple[Recording, Path], foreign: Callable[[str, Path], dict[str, Any]]
) -> None:
    recording, path = exported
    counts = np.moveaxis(from_time_0(recording), 0, 2)
    ours = by_us(path)
    vendor, phconvert = foreign("snapi", path), foreign("phconvert", path)
    assert np.array_equal(vendor["raw"], records_of(path))
    for found in (found_by(vendor), found_by(phconvert), by_ptufile(path)):
        assert found.same(ours)
    assert len(ours.photons) == counts.sum()
    assert (ours.markers[:, 1] == 1).sum() == (ours.markers[:, 1] == 2).sum() == recording.plan.wall.rows
    assert float(phconvert["bin_width_s"]) == pytest.approx(recording.plan.axis.bin_width_s)
    assert float(phconvert["acquisition_s"]) == pytest.approx(recording.transient().exposure_s.sum(), abs=1e-3)
    assert np.array_equal(pixels_of(found_by(vendor), counts.shape, path), counts)


def pixels_of(found: Found, shape: tuple[int, ...], path: Path) -> npt.NDArray[np.float64]:
    """Histograms by the vendor's photons and line markers alone, as an imaging program would make them."""
    with ptufile.PtuFile(path) as file:
        tags = file.tags
    dwell = round(float(tags["ImgHdr_TimePerPixel"]) * 1e-3 / float(tags["MeasDesc_GlobalResolution"]))
    begins = found.markers[found.markers[:, 1] == 1, 0]
    rows = np.searchsorted(begins, found.photons[:, 0], side="right") - 1
    cols = (found.photons[:, 0] - begins[rows]) // dwell
    counts = np.zeros(shape)
    np.add.at(counts, (rows, cols, found.photons[:, 1]), 1)
    return counts


def test_the_way_back_brings_the_same_histograms(exported: tuple[Recording, Path]) -> None:
    """But for empty bins after the last photon: a PTU does not say how many there were."""
    recording, path = exported
    counts, back = from_time_0(recording), read_any(path).transient.counts
    assert np.array_equal(back, counts[: len(back)])
    assert not counts[len(back) :].any()


@pytest.mark.parametrize("reader", ["snapi", "phconvert", "ptufile"])
@pytest.mark.parametrize("exported", ["multiharp"], indirect=True)
def test_any_records_are_read_alike(
    tmp_path: Path, foreign: Callable[[str, Path], dict[str, Any]], exported: tuple[Recording, Path], reader: str
) -> None:
    """A million records drawn at random: all 63 channels, marker inputs singly and together, wraps of 0 to 1023.

    But none of 0 for the vendor's library: docs/peers.md.
    """
    rng = np.random.default_rng(17)
    kind = rng.choice(3, 1_000_000, p=(0.9, 0.05, 0.05))
    pulse = rng.integers(0, 1024, len(kind))
    photon = rng.integers(0, 63, len(kind)) << 25 | rng.integers(0, 1 << 15, len(kind)) << 10 | pulse
    marker = 1 << 31 | rng.integers(1, 16, len(kind)) << 25 | pulse
    overflow = 1 << 31 | 63 << 25 | rng.choice((int(reader == "snapi"), 1, 2, 1023), len(kind))
    records = np.choose(kind, (photon, marker, overflow)).astype("<u4")
    path = tmp_path / "any.ptu"
    header = bytearray(exported[1].read_bytes())
    with ptufile.PtuFile(exported[1]) as file:
        begin = file.record_offset
    for tag, value in (("TTResult_NumberOfRecords", len(records)), ("HW_InpChannels", 64)):
        at = header.index(tag.encode()) + 40
        header[at : at + 8] = struct.pack("<q", value)
    path.write_bytes(bytes(header[:begin]) + records.tobytes())
    ours = by_us(path)
    assert (len(ours.photons), len(ours.markers)) == ((kind == 0).sum(), (kind == 1).sum())
    found = by_ptufile(path) if reader == "ptufile" else found_by(foreign(reader, path))
    assert found.same(ours)


def test_what_phconvert_makes_of_it_is_the_same_scan(
    exported: tuple[Recording, Path], foreign_python: Callable[..., Path], tmp_path: Path
) -> None:
    recording, path = exported
    script = Path(__file__).parent / "picoquant" / "to_photon_hdf5.py"
    command = [foreign_python("phconvert"), script, path, tmp_path / "photons.h5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    scan, back = recording.transient(), read_any(tmp_path / "photons.h5").transient
    before = round(scan.time.start_s / scan.time.bin_width_s)  # delays in a PTU count from time 0
    counts = np.pad(scan.counts, ((before, 0), (0, 0), (0, 0)))
    assert np.array_equal(back.counts, counts[: back.time.bins])
    assert not counts[back.time.bins :].any()
    assert back.time.bin_width_s == pytest.approx(scan.time.bin_width_s)
