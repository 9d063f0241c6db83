"""What each key of `nlos jog` does, on an open bench without a terminal."""

import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from nlos.acquisition.planning.preflight import drawn_aim
from nlos.by_hand import lines
from nlos.by_hand.hand import Hand
from nlos.by_hand.jogging import Jog
from nlos.by_hand.keys import Keys
from nlos.by_hand.marks import Marks
from nlos.by_hand.row import row
from nlos.by_hand.stops import Stops
from nlos.by_hand.summary import Summary
from nlos.calibration_input import read_spots
from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.errors import LimitError, SafetyTrip
from nlos.drivers.partial_bench import open_partial_bench
from tests.nlos.by_hand.witness import bench_file

STEP_DEG = 0.1


@pytest.fixture
def hand(tmp_path: Path) -> Iterator[Hand]:
    allowed = {"left_m": -0.3, "right_m": 0.3, "bottom_m": -0.2, "top_m": 0.2}
    path = bench_file(tmp_path, {"geometry": {"allowed": allowed}})
    settings = load("bench", str(path), BenchSettings).settings
    with open_partial_bench(settings, {"mirror", "counter"}) as bench:
        found = Hand(bench, drawn_aim(settings.geometry), Keys(None), Stops())
        yield found
        found.light.end("the test is over")


@pytest.fixture
def jog(hand: Hand, tmp_path: Path) -> Jog:
    return Jog(hand, Marks(tmp_path / "spots.csv"))


def press(jog: Jog, *keys: str) -> None:
    for key in keys:
        for each in (key,) if key in ("left", "right", "up", "down", "enter", "escape", "space", "backspace") else key:
            jog.press("space" if each == " " else each)


def updated(hand: Hand, there: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 60
    while not there():
        assert time.monotonic() < until_s
        hand.update()


def at_deg(hand: Hand) -> tuple[float, float]:
    return math.degrees(hand.angles.x_rad), math.degrees(hand.angles.y_rad)


def test_arrows_move_the_beam_by_a_step_the_way_they_point(hand: Hand, jog: Jog) -> None:
    for key, place in (("right", (1, 0)), ("up", (1, 1)), ("left", (0, 1)), ("down", (0, 0))):
        press(jog, key)
        assert at_deg(hand) == pytest.approx([each * STEP_DEG for each in place], abs=1e-9)
    press(jog, "+", "right", "-", "-", "up")
    assert at_deg(hand) == pytest.approx((0.2, 0.05))
    press(jog, "0")
    assert at_deg(hand) == (0.0, 0.0)
    assert hand.bench.simulated is not None
    press(jog, "g", "0.1 0,05", "enter")
    assert hand.reach is not None
    assert hand.reach.place_of(hand.angles) == pytest.approx((0.1, 0.05), abs=1e-6)
    assert hand.bench.simulated.spot_m(hand.bench.simulated.beam) == pytest.approx((0.1, 0.05), abs=1e-3)


@pytest.mark.parametrize("place", ["0.31 0", "0 -0.21", "9 9"])
def test_nothing_moves_to_where_the_beam_may_not_be(hand: Hand, jog: Jog, place: str) -> None:
    press(jog, "g", "0.295 0.195", "enter")
    before = hand.angles
    press(jog, "g", place, "enter")
    assert hand.angles == before
    assert hand.notes
    press(jog, *"+" * 8, "right")
    assert hand.angles == before


def test_a_question_that_is_left_does_nothing_and_keys_mean_what_they_did(hand: Hand, jog: Jog, tmp_path: Path) -> None:
    press(jog, "g", "0.2 0.1", "escape")
    assert (at_deg(hand), hand.typing) == ((0.0, 0.0), False)
    press(jog, "m", "0.2 0.1x", "backspace", "escape", "right")
    assert not (tmp_path / "spots.csv").exists()
    assert at_deg(hand) == pytest.approx((STEP_DEG, 0.0))


def test_a_mark_is_what_was_typed_else_what_the_ruler_says(hand: Hand, jog: Jog, tmp_path: Path) -> None:
    press(jog, "g", "0.2 -0.1", "enter", "m", "enter")
    press(jog, "m", "0.21 -0,11x", "backspace", "enter")
    press(jog, "0", "m", "enter")
    spots = read_spots(tmp_path / "spots.csv")
    assert list(zip(spots.x_m.tolist(), spots.y_m.tolist(), strict=True)) == [(0.2, -0.1), (0.21, -0.11), (0.0, 0.0)]
    assert spots.x_rad[:2] == pytest.approx([spots.x_rad[0]] * 2)


def test_z_shows_the_peak_from_both_sides_and_the_whole_period_again(hand: Hand, jog: Jog) -> None:
    assert hand.watch is not None
    hand.ask_for_light(20.0)
    updated(hand, lambda: hand.peak is not None)
    assert hand.peak is not None
    at_s, whole = hand.peak.time_s, hand.watch.axis
    press(jog, "z")
    axis = hand.watch.axis
    assert axis.offset_s <= at_s - 2e-9 < axis.offset_s + 1.1e-9
    assert axis.offset_s + axis.bins * axis.bin_width_s == pytest.approx(at_s + 2e-9, abs=0.1e-9)
    press(jog, "z")
    assert hand.watch.axis == whole


def test_rates_and_the_peak_are_those_of_a_second(hand: Hand) -> None:
    """And what is summed is of one place and one kind of light."""
    assert hand.watch is not None
    watch = hand.watch
    hand.ask_for_light(20.0)
    updated(hand, lambda: hand.peak is not None and watch.summed_s >= 0.5)
    reading, peak = hand.reading, hand.peak
    assert reading is not None
    assert peak is not None
    said = "\n".join(lines.counts(hand))
    assert f"{reading.detector_hz / 10e6:.2%} of the pulses" in said
    assert lines.rate(peak.counts / hand.watch.summed_s, "counts/s") in said
    assert "the bench file says" not in said
    assert row(hand)["direct_hz"] == pytest.approx(peak.counts / hand.watch.summed_s, abs=0.1)
    assert peak.counts / hand.watch.summed_s < 2 * reading.detector_hz
    hand.move_to(hand.angles)
    assert hand.watch.summed_s == 0.0
    updated(hand, lambda: watch.summed_s >= 0.2)
    hand.light.end("dark from now on")
    updated(hand, lambda: hand.reading is not None and hand.reading.lit is False)
    assert hand.watch.summed_s < 0.05
    assert hand.watch.summed.sum() < 0.1 * reading.histogram.total_count


def test_a_spot_that_was_lit_since_the_beam_came_is_no_spot_in_the_dark(hand: Hand, jog: Jog) -> None:
    press(jog, "right")
    hand.ask_for_light(5.0)
    hand.update()
    hand.light.end("seen")
    hand.update()
    press(jog, "m", "0 0", "enter")
    assert not any("with the light off" in note for note in hand.notes)
    press(jog, "left", "m", "0 0", "enter")
    assert any("with the light off" in note for note in hand.notes)


def test_a_space_that_is_typed_with_its_question_is_no_wish_for_light(hand: Hand, jog: Jog) -> None:
    keyboard, fingers = os.pipe()
    hand.keys = Keys(keyboard)
    os.write(fingers, b"g 0.1 0.1\r")
    for key in hand.pressed():
        jog.press(key)
    assert not hand.light.wanted
    assert hand.reach is not None
    assert hand.reach.place_of(hand.angles) == pytest.approx((0.1, 0.1), abs=1e-6)
    os.close(keyboard)
    os.close(fingers)


def test_no_light_where_the_beam_may_not_be(tmp_path: Path) -> None:
    allowed = {"left_m": 0.1, "right_m": 0.3, "bottom_m": -0.2, "top_m": 0.2}
    settings = load("bench", str(bench_file(tmp_path, {"geometry": {"allowed": allowed}})), BenchSettings).settings
    with open_partial_bench(settings, {"mirror"}) as bench:
        hand = Hand(bench, drawn_aim(settings.geometry), Keys(None), Stops())
        assert hand.reach is not None
        with pytest.raises(LimitError, match="outside"):
            hand.ask_for_light(1.0)
        assert not hand.light.lit
        hand.move_to(hand.reach.angles_of(0.2, 0.0))
        hand.ask_for_light(1.0)
        hand.light.end("seen")


@pytest.mark.parametrize(("stated_hz", "said"), [(10.05e6, False), (10.2e6, True)])
def test_a_sync_that_is_not_the_bench_files_is_said(hand: Hand, stated_hz: float, said: bool) -> None:
    settings = hand.bench.settings
    laser = settings.laser.model_copy(update={"repetition_hz": stated_hz})
    hand.bench.settings = settings.model_copy(update={"laser": laser})
    updated(hand, lambda: hand.reading is not None)
    assert ("the bench file says 10.2 MHz" in lines.counts(hand)[0]) == said


def test_the_newest_of_what_was_said_is_seen(hand: Hand) -> None:
    for number in range(3):
        hand.note(f"{number}: " + "said at length " * 6)
    shown = lines.notes(hand, 40)
    assert len(shown) == 4
    assert any(line.startswith("2: ") for line in shown)
    assert not any(line.startswith("0: ") for line in shown)


def test_a_gate_in_which_the_light_changed_is_neither_light_nor_dark(hand: Hand) -> None:
    summary = Summary(hand.light)

    def mixed() -> bool:
        if not hand.light.wanted:  # on a busy machine it may have come and gone between two gates
            hand.ask_for_light(0.5)
        return hand.reading is not None and hand.reading.lit is None

    updated(hand, mixed)
    assert row(hand)["light"] == "mixed"
    summary.add(hand)
    assert (summary.values()["lit_hz"], summary.values()["dark_hz"]) == (None, None)
    updated(hand, lambda: hand.reading is not None and hand.reading.lit is False)
    assert row(hand)["light"] == 0
    summary.add(hand)
    assert summary.values()["lit_hz"] is None


@pytest.mark.parametrize("alignment", [{}, {"duty": 0.17, "period_s": 0.5}], ids=["all the time", "in short flashes"])
def test_too_much_light_by_hand_is_shut_off(tmp_path: Path, alignment: dict[str, float]) -> None:
    """Though no gate may be lit from its beginning to its end."""
    path = bench_file(tmp_path, {"safety": {"trip_cps": 1000.0}, "alignment": alignment})
    settings = load("bench", str(path), BenchSettings).settings
    with open_partial_bench(settings, {"mirror", "counter"}) as bench:
        hand = Hand(bench, drawn_aim(settings.geometry), Keys(None), Stops())
        hand.ask_for_light(20.0)
        with pytest.raises(SafetyTrip, match="above 1e"):
            updated(hand, lambda: False)
        assert not hand.light.lit
        with pytest.raises(SafetyTrip, match="stays closed after a trip"):  # noqa: PT012 - at once, or with a flash
            hand.ask_for_light(20.0)
            updated(hand, lambda: False)
        hand.light.end("the test is over")
