"""T3 streams at their edges: values at the ends of fields, records a little out of order, windows that only touch."""

import numpy as np
import pytest

from nlos.drivers.tcspc.t3 import GENERIC, PICOHARP_300, T3Decoder, T3Events, T3Format
from nlos.drivers.tcspc.t3_points import PointHistograms, StepMarkers

SYNC = 1 << 31  # special, channel 0: a laser pulse by itself
PICOHARP_WRAP = 15 << 28


def photon(pulse: int, delay: int) -> int:
    return delay << 10 | pulse


def marker(pulse: int, bits: int) -> int:
    return 1 << 31 | bits << 25 | pulse


def fed(decoder: T3Decoder, *records: int) -> T3Events:
    return decoder.feed(np.array(records, dtype=np.uint32))


def by_one(histograms: PointHistograms, records: list[int]) -> PointHistograms:
    decoder = T3Decoder(GENERIC)
    for record in records:
        histograms.add(fed(decoder, record))
    histograms.finish()
    return histograms


def test_all_four_marker_inputs_at_once_are_a_marker_and_what_is_above_them_is_none() -> None:
    events = fed(T3Decoder(GENERIC), marker(5, 15), marker(6, 16), SYNC, photon(7, 3))
    assert events.marker_bits.tolist() == [15]
    assert events.marker_pulses.tolist() == [5]
    assert events.photon_pulses.tolist() == [7]


@pytest.mark.parametrize(("layout", "record", "wrap"), [(GENERIC, SYNC, 0), (PICOHARP_300, PICOHARP_WRAP, 1 << 16)])
def test_the_first_special_record_of_all_is_no_photon(layout: T3Format, record: int, wrap: int) -> None:
    events = fed(T3Decoder(layout), record, 7)
    assert events.photon_pulses.tolist() == [wrap + 7]


def test_what_has_been_decoded_never_becomes_less() -> None:
    decoder = T3Decoder(GENERIC)
    assert [fed(decoder, photon(pulse, 0)).until_pulse for pulse in (900, 100, 950)] == [900, 900, 950]


def test_a_marker_recorded_after_photons_of_its_window_still_has_them() -> None:
    records = [photon(50, 1), photon(250, 2), photon(300, 3), marker(100, 1), photon(900, 4)]
    histograms = by_one(PointHistograms(1, 8, StepMarkers(np.array([500]), 0), disorder=300), records)
    assert histograms.counts[0].tolist() == [0, 0, 1, 1, 0, 0, 0, 0]
    assert histograms.between == 2


def test_photons_that_are_out_of_order_keep_their_delays() -> None:
    histograms = PointHistograms(1, 8, StepMarkers(np.array([500]), 0), disorder=0)
    histograms.add(fed(T3Decoder(GENERIC), marker(0, 1), photon(700, 1), photon(400, 3)))
    histograms.finish()
    assert histograms.counts[0].tolist() == [0, 0, 0, 1, 0, 0, 0, 0]


def test_a_window_has_its_first_pulse_and_not_its_last() -> None:
    records = [marker(100, 1), *(photon(pulse, 0) for pulse in (199, 200, 299, 300))]
    histograms = by_one(PointHistograms(1, 1, StepMarkers(np.array([100]), 100), disorder=0), records)
    assert (histograms.totals[0], histograms.between) == (2, 2)
    assert histograms.started.tolist() == [200]


@pytest.mark.parametrize(("lost", "flagged"), [((100, 200), False), ((99, 200), True), ((100, 201), True)])
def test_records_lost_between_windows_spoil_neither(lost: tuple[int, int], flagged: bool) -> None:
    histograms = PointHistograms(2, 1, StepMarkers(np.array([100, 100]), 0), disorder=0)
    histograms.mark_lost(*lost)
    by_one(histograms, [marker(0, 1), marker(200, 2), photon(400, 0)])
    assert histograms.lost.any() == flagged


def test_a_step_too_early_and_one_too_late_disagree_though_as_many_as_were_due() -> None:
    find = StepMarkers(np.full(6, 100), 10)
    find(np.array([0, 0, 400, 600]), np.array([5, 2, 1, 2], dtype=np.uint8))
    seen, due = find.against(200)
    assert seen != due


@pytest.mark.parametrize("at_once", [False, True])
def test_a_step_that_comes_a_little_early_takes_that_much_of_its_point(at_once: bool) -> None:
    """As half of them do where nothing is blanked: a controller polls its trigger, and pulses are counted whole."""
    histograms = PointHistograms(4, 8, StepMarkers(np.full(4, 100), 0), disorder=0)
    steps = {0: 1, 99: 2, 199: 1, 290: 2}
    records = []
    for pulse in (0, 50, 98, 99, 198, 199, 289, 290, 389):
        records += [marker(pulse, steps[pulse])] if pulse in steps else []
        records.append(photon(pulse, 3))
    if at_once:
        histograms.add(fed(T3Decoder(GENERIC), *records))
        histograms.finish()
    else:
        by_one(histograms, records)
    assert histograms.lost.tolist() == [False] * 4
    assert histograms.exposed.tolist() == [0.99, 1.0, 0.91, 1.0]
    assert histograms.totals.tolist() == [3, 2, 2, 2]
