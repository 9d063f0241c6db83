"""T3 records: against real files decoded by another program, and against a decoder that reads one record at a time."""

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import ptufile
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.drivers.tcspc.t3 import FORMATS as LAYOUTS
from nlos.drivers.tcspc.t3 import GENERIC, HYDRAHARP_V1, PICOHARP_300, Pulses, T3Decoder, T3Format
from nlos.drivers.tcspc.t3_points import PointHistograms, StepMarkers, Windows

SHARED = Path(__file__).parents[4] / "shared" / "data" / "tcspc"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data/tcspc is not here")
FORMATS = [GENERIC, HYDRAHARP_V1, PICOHARP_300]


class LineMarkers:
    """Lines between a start and a stop marker, each cut into `columns` equal parts: how imaging PTU files mark them."""

    def __init__(self, columns: int, start_bit: int, stop_bit: int) -> None:
        self._columns, self._start_bit, self._stop_bit = columns, start_bit, stop_bit
        self._started: int | None = None
        self.lines = 0

    def __call__(self, pulses: Pulses, bits: npt.NDArray[np.uint8]) -> Windows:
        lines = []
        for pulse, bit in zip(pulses.tolist(), bits.tolist(), strict=True):
            # A stop and a start at the same pulse end one line and begin the next.
            if bit & self._stop_bit and self._started is not None:
                lines.append((self._started, pulse))
                self._started = None
            if bit & self._start_bit:
                self._started = pulse
        edges = np.array(lines, dtype=np.int64).reshape(-1, 2)
        # The first pulse of column k is the smallest t with floor((t - start) columns / length) = k.
        column = np.arange(self._columns + 1)
        cuts = edges[:, :1] - (-column * (edges[:, 1:] - edges[:, :1]) // self._columns)
        point = np.arange(self.lines * self._columns, (self.lines + len(lines)) * self._columns)
        self.lines += len(lines)
        return Windows(point, cuts[:, :-1].ravel(), cuts[:, 1:].ravel(), self._started)


def photon(layout: T3Format, pulse: int, delay: int, channel: int = 0) -> int:
    record = (channel + layout.first_channel) << (layout.pulse_bits + layout.delay_bits)
    return record | delay << layout.pulse_bits | pulse % layout.wrap


def marker(layout: T3Format, pulse: int, bits: int) -> int:
    if layout is PICOHARP_300:
        return 15 << 28 | bits << 16 | pulse % layout.wrap
    return 1 << 31 | bits << 25 | pulse % layout.wrap


def overflow(layout: T3Format, wraps: int = 1) -> int:
    if layout is PICOHARP_300:
        return 15 << 28
    return 1 << 31 | 63 << 25 | (wraps if layout.counts_wraps else 1)


def stream(layout: T3Format, events: list[tuple[int, int, int]]) -> bytes:
    """(pulse, marker bits or 0, delay) in the order given -> records; time may step back within one wrap."""
    records, base = [], 0
    for pulse, bits, delay in events:
        wraps = pulse // layout.wrap - base
        base += max(wraps, 0)
        if wraps > 0:
            records += [overflow(layout, wraps)] if layout.counts_wraps else [overflow(layout)] * wraps
        records.append(marker(layout, pulse, bits) if bits else photon(layout, pulse, delay))
    return np.array(records, dtype="<u4").tobytes()


def one_by_one(layout: T3Format, data: bytes) -> list[tuple[str, int, int]]:
    """The reference: the loop of the vendor's demo programs."""
    base, found = 0, []
    for (record,) in struct.iter_unpack("<I", data):
        pulse = record & (layout.wrap - 1)
        if layout is PICOHARP_300:
            channel, delay = record >> 28, record >> 16 & 0xFFF
            if channel != 15:
                found.append(("photon", base + pulse, delay))
            elif delay & 15 == 0:
                base += layout.wrap
            else:
                found.append(("marker", base + pulse, delay & 15))
        else:
            special, channel, delay = record >> 31, record >> 25 & 63, record >> 10 & 0x7FFF
            if not special:
                found.append(("photon", base + pulse, delay))
            elif channel == 63:
                base += layout.wrap * (pulse or 1 if layout.counts_wraps else 1)
            elif 1 <= channel <= 15:
                found.append(("marker", base + pulse, channel))
    return found


def decoded(decoder: T3Decoder, pieces: list[bytes]) -> tuple[list[tuple[str, int, int]], list[tuple[str, int, int]]]:
    photons, markers = [], []
    for piece in pieces:
        events = decoder.feed(piece)
        delays = decoder.format.delays(events.photons).tolist()
        photons += [("photon", p, d) for p, d in zip(events.photon_pulses.tolist(), delays, strict=True)]
        markers += [
            ("marker", p, b) for p, b in zip(events.marker_pulses.tolist(), events.marker_bits.tolist(), strict=True)
        ]
    return photons, markers


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@pytest.mark.parametrize("layout", FORMATS, ids=lambda layout: layout.name)
@settings(deadline=None, max_examples=150)
@given(words=st.lists(st.integers(0, 2**32 - 1), max_size=60), cuts=st.lists(st.integers(0, 240), max_size=6))
def test_any_records_in_any_pieces_decode_as_one_by_one(layout: T3Format, words: list[int], cuts: list[int]) -> None:
    data = np.array(words, dtype="<u4").tobytes()
    reference = one_by_one(layout, data)
    photons, markers = decoded(T3Decoder(layout), split(data, cuts))
    assert photons == [event for event in reference if event[0] == "photon"]
    assert markers == [event for event in reference if event[0] == "marker"]


def test_an_overflow_record_of_zero_stands_for_one_wrap_and_of_n_for_n() -> None:
    words = [overflow(GENERIC, 0), photon(GENERIC, 3, 7), overflow(GENERIC, 5), photon(GENERIC, 3, 7)]
    events = T3Decoder(GENERIC).feed(np.array(words, dtype=np.uint32))
    assert events.photon_pulses.tolist() == [1024 + 3, 6 * 1024 + 3]
    old = T3Decoder(HYDRAHARP_V1).feed(np.array(words, dtype=np.uint32))
    assert old.photon_pulses.tolist() == [1024 + 3, 2 * 1024 + 3]


def test_a_record_cut_off_waits_for_its_last_byte() -> None:
    decoder = T3Decoder(GENERIC)
    whole = stream(GENERIC, [(5, 0, 1), (9, 0, 1)])
    assert decoder.feed(whole[:-1]).photon_pulses.tolist() == [5]
    assert decoder.feed(whole[-1:]).photon_pulses.tolist() == [9]


def scanned(
    layout: T3Format, cuts: list[int], disorder: int, seed: int, points: int = 5
) -> tuple[PointHistograms, np.ndarray, StepMarkers, int]:
    """A scan of `points` steps of 300 pulses blanking and 2000 dwell, its markers recorded up to `disorder` late."""
    rng = np.random.default_rng(seed)
    steps = [100 + 2500 * k for k in range(points)]
    pulses = np.sort(rng.integers(0, 2500 * points + 500, 400))
    delays = rng.integers(0, 40, 400)
    truth = np.zeros((points, 32), dtype=np.uint32)
    outside = 0
    events: list[tuple[int, int, int]] = []
    for pulse, delay in zip(pulses.tolist(), delays.tolist(), strict=True):
        point, phase = divmod(pulse - 100, 2500)
        inside = 0 <= point < points and 300 <= phase < 2300
        outside += not inside
        if inside and 4 <= delay < 36:
            truth[point, delay - 4] += 1
        events.append((pulse, 0, delay))
    for k, step in enumerate(steps):
        late = step + int(rng.integers(0, disorder))
        place = sum(pulse <= late for pulse, _, _ in events)
        events.insert(place, (step, 1 + k % 2, 0))
    find = StepMarkers(np.full(points, 2000), 300)
    histograms = PointHistograms(points, 32, find, first_bin=4, disorder=1100)
    decoder = T3Decoder(layout)
    for piece in split(stream_out_of_order(layout, events), cuts):
        histograms.add(decoder.feed(piece))
    histograms.finish()
    return histograms, truth, find, outside


def stream_out_of_order(layout: T3Format, events: list[tuple[int, int, int]]) -> bytes:
    """As `stream`, with markers dropped into the wrap that is current where they are recorded."""
    current, kept = 0, []
    for pulse, bits, delay in events:
        current = max(current, pulse)
        if bits and pulse // layout.wrap != current // layout.wrap:
            pulse = current // layout.wrap * layout.wrap
        kept.append((pulse, bits, delay))
    return stream(layout, kept)


@pytest.mark.parametrize("layout", [GENERIC, PICOHARP_300], ids=lambda layout: layout.name)
@settings(deadline=None, max_examples=60)
@given(cuts=st.lists(st.integers(0, 1700), max_size=8), seed=st.integers(0, 10**6))
def test_photons_go_to_the_point_in_whose_dwell_they_arrived(layout: T3Format, cuts: list[int], seed: int) -> None:
    histograms, truth, find, outside = scanned(layout, cuts, 1, seed)
    assert (histograms.counts == truth).all()
    assert histograms.between == outside
    assert histograms.complete == find.seen == 5
    assert find.against(2500) == (5, 5)


@settings(deadline=None, max_examples=60)
@given(cuts=st.lists(st.integers(0, 1700), max_size=8), seed=st.integers(0, 10**6))
def test_markers_recorded_after_later_photons_change_nothing(cuts: list[int], seed: int) -> None:
    histograms, truth, _, _ = scanned(PICOHARP_300, cuts, 280, seed)
    assert (histograms.counts == truth).all()


TURNS = [1 | 4, 2, 1, 2, 1, 2]


@pytest.mark.parametrize(
    ("pulses", "bits"),
    [
        ([200, 400, 600], TURNS[1:4]),  # the first is lost
        ([400, 600, 800], TURNS[2:5]),  # the first two are lost, and with them marker 3
        ([0, 400, 600], [TURNS[0], *TURNS[2:4]]),  # one in the middle is lost
        ([0, 0, 200], TURNS[:3]),  # the mirror took two steps at once
        ([0, 70, 200, 400], TURNS[:4]),  # one too many
        ([0, 130, 200, 400], TURNS[:4]),
        ([0, 200, 400], [TURNS[0], 2, 2]),  # a wire that saw the other's edge
    ],
)
def test_markers_that_are_missing_or_too_many_disagree_at_once(pulses: list[int], bits: list[int]) -> None:
    find = StepMarkers(np.full(6, 100), 10)
    if pulses[0] == 400:
        find(np.array([0]), np.array([4], dtype=np.uint8))  # marker 3 alone came through
    find(np.array(pulses), np.array(bits, dtype=np.uint8))
    seen, due = find.against(200)
    assert seen != due


def test_steps_after_the_last_point_are_no_steps_too_many() -> None:
    find = StepMarkers(np.full(3, 100), 10)
    find(np.array([0, 205, 395, 600]), np.array([5, 2, 1, 5], dtype=np.uint8))
    assert find.against(200) == (3, 3)
    windows = find(np.array([800]), np.array([1], dtype=np.uint8))
    assert (find.seen, len(windows.point)) == (5, 0)


def test_points_exposed_while_records_were_lost_are_flagged() -> None:
    histograms = PointHistograms(3, 8, StepMarkers(np.full(3, 1000), 0), disorder=0)
    events = [(0, 1, 0), (10, 0, 3), (2000, 2, 0), (4000, 1, 0), (6000, 0, 1)]
    decoder = T3Decoder(GENERIC)
    data = stream(GENERIC, events)
    histograms.mark_lost(2500, 2600)
    for at in range(0, len(data), 4):
        histograms.add(decoder.feed(data[at : at + 4]))
    histograms.finish()
    assert histograms.lost.tolist() == [False, True, False]


@pytest.mark.parametrize("piece", [4, 10_000])
def test_a_step_that_comes_too_early_cuts_its_point_short_and_flags_it(piece: int) -> None:
    histograms = PointHistograms(4, 8, StepMarkers(np.full(4, 1000), 100), disorder=0)
    events = [(0, 1, 0), (500, 0, 3), (600, 2, 0), (650, 0, 3), (900, 0, 3), (1900, 1, 0), (1900, 2, 0), (2500, 0, 1)]
    data = stream(GENERIC, events)
    decoder = T3Decoder(GENERIC)
    for at in range(0, len(data), piece):
        histograms.add(decoder.feed(data[at : at + piece]))
    histograms.finish()
    assert histograms.lost.tolist() == [True, False, True, False]
    assert histograms.totals.tolist() == [2, 1, 0, 1]


def test_lines_beyond_the_image_are_left_out() -> None:
    histograms = PointHistograms(4, 2, LineMarkers(2, 1, 2), disorder=0)
    events = [(k * 100, bit, 0) for k in range(4) for bit in (2, 1)] + [(350, 0, 1), (400, 2, 0)]
    histograms.add(T3Decoder(GENERIC).feed(stream(GENERIC, events)))
    histograms.finish()
    assert (histograms.complete, histograms.between) == (4, 1)


def test_photons_of_other_channels_are_left_out() -> None:
    words = [marker(GENERIC, 0, 1), photon(GENERIC, 5, 2, channel=0), photon(GENERIC, 6, 2, channel=3)]
    for channel, expected in ((None, 2), (0, 1), (3, 1), (2, 0)):
        histograms = PointHistograms(1, 4, StepMarkers(np.full(1, 100), 0), channel=channel)
        histograms.add(T3Decoder(GENERIC).feed(np.array(words, dtype=np.uint32)))
        histograms.finish()
        assert histograms.counts[0, 2] == expected


@needs_shared
@pytest.mark.parametrize("piece", [1 << 18, 99_999])
def test_a_real_picoharp_image_decodes_as_by_its_reference(piece: int) -> None:
    expected = np.load(SHARED / "picoharp_t3_image_hazelnut_frame1_expected.npz")
    histograms = image("picoharp_t3_image_hazelnut_frame1.ptu", 256, 134, piece)
    assert (histograms.totals.reshape(256, 256) == expected["image_counts"]).all()
    assert (histograms.counts.sum(axis=0) == expected["histogram"]).all()
    assert histograms.totals.sum() == expected["photons"]


@needs_shared
def test_a_replayed_scan_gives_the_expected_histograms() -> None:
    expected = np.load(SHARED / "replay_s_u_expected.npz")
    histograms = image("replay_s_u.ptu", 64, 4096, 1 << 18)
    assert (histograms.counts.reshape(64, 64, 4096) == expected["histograms"]).all()


def image(name: str, size: int, bins: int, piece: int) -> PointHistograms:
    with ptufile.PtuFile(SHARED / name) as file:
        decoder, data = T3Decoder(LAYOUTS[int(file.record_type)]), file.read_records().tobytes()
        start, stop = (1 << (int(file.tags[f"ImgHdr_Line{end}"]) - 1) for end in ("Start", "Stop"))
    histograms = PointHistograms(size * size, bins, LineMarkers(size, start, stop))
    for at in range(0, len(data), piece):
        histograms.add(decoder.feed(data[at : at + piece]))
    histograms.finish()
    return histograms
