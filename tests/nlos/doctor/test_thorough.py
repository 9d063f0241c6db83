"""`nlos doctor --thorough`: what it says about healthy benches, about ill ones, and who agrees to light."""

import builtins
import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.__main__ import run
from nlos.cli.benches import load_bench
from nlos.cli.terminal import terminal
from nlos.doctor import dark_trials, examination, hands, shutter_trials, small_scan
from nlos.doctor.dark_trials import judged
from nlos.doctor.examination import LIT, Visit, examine
from nlos.doctor.findings import Finding
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.simulated.beam import Misalignment
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.servo import ServoSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.tcspc488.protection import Protection
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.drivers.trip_latch import TripLatch

HEALTHY = ("simulated", "optotune", "multiharp", "helios", "moving")
SLOW = ("timetagger", "zero_latency", "drawn")


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(small_scan, "_reconstruction", lambda *about: iter(()))
    for name, value in (("as_json", False), ("verbosity", -9), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


def thorough(settings: BenchSettings, light: bool = True) -> dict[str, Finding]:
    """Line -> its worst finding."""
    found: dict[str, Finding] = {}
    table = replace(load_bench(None), settings=settings)
    for each in examine(table, Visit(lambda bench: light, None, thorough=True)):
        order = ("SKIP", "PASS", "WARN", "FAIL")
        if each.what not in found or order.index(each.verdict) > order.index(found[each.what].verdict):
            found[each.what] = each
    return found


def simulated(name: str = "simulated", **changes: Any) -> BenchSettings:
    chosen = load_bench(name).settings
    assert chosen.simulation is not None
    return chosen.model_copy(update={"simulation": chosen.simulation.model_copy(update=changes)})


@pytest.mark.sampled(2)
@pytest.mark.soak
@pytest.mark.parametrize("name", HEALTHY + (SLOW if os.environ.get("NLOS_SOAK") == "1" else ()))
def test_a_healthy_bench_passes_and_what_it_lacks_is_skipped_by_name(name: str) -> None:
    found = thorough(simulated(name))
    assert not [each for each in found.values() if each.verdict == "FAIL"]
    said = {what: each.verdict for what, each in found.items()}
    always = (
        "direct light",
        "corners",
        "dark histogram",
        "linearity",
        "count rates",
        "beam",
        "settling",
        "trip",
        "cable",
        "replugged",
    )
    assert {said[what] for what in always} == {"PASS"}
    assert said["read-back"] == ("PASS" if name == "optotune" else "SKIP")
    assert said["markers"] == ("SKIP" if name == "optotune" else "PASS")
    assert said["watchdog"] == said["interlock"] == ("SKIP" if name in ("multiharp", "timetagger") else "PASS")
    assert {what for what, each in found.items() if each.chart} >= {"dark histogram", "linearity", "settling"}
    assert TripLatch.of_bench(simulated(name)).standing() is None, "trips that were provoked outlast nothing"


def test_the_page_holds_serial_numbers_and_curves_and_loads_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--thorough", "--light", "-o", "day-one.html", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    page = Path("day-one.html").read_text("utf-8")
    assert said["page"] == "day-one.html"
    assert "SIM0001" in page
    assert page.count("<svg") == 4
    assert not re.search(r"<(script|link|iframe)|(src|href)=|url\(|@import", page)
    assert "prefers-color-scheme: dark" in page
    for finding in said["findings"]:
        assert finding["what"] in page
    assert run(["doctor", "--thorough", "-o", "day-one.html"]) == 6
    assert run(["doctor", "--thorough", "-o", "day-one.pdf"]) == 2
    assert run(["doctor", "-o", "other.html"]) == 2
    assert Path("day-one.html").read_text("utf-8") == page


def test_off_a_terminal_there_is_no_light_without_the_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[bool] = []
    monkeypatch.setattr(SimulatedBench, "set_shutter", lambda self, is_open: opened.append(is_open))
    assert run(["doctor", "--thorough", "--json"]) == 0
    found = {each["what"]: each["verdict"] for each in json.loads(capsys.readouterr().out)["findings"]}
    assert {found[check.name] for check in LIT} == {"SKIP"}
    assert found["scan"] == "WARN"
    assert found["linearity"] == found["cable"] == "PASS"
    assert not any(opened)


@pytest.mark.parametrize(("answer", "light"), [("light", True), ("", False), ("y", False)])
def test_on_a_terminal_light_is_agreed_to_in_words_that_say_where(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, answer: str, light: bool
) -> None:
    monkeypatch.setattr("nlos.cli.doctor.somebody_is_there", lambda: True)
    monkeypatch.setattr(builtins, "input", lambda: answer)
    assert run(["doctor", "--thorough", "-o", "page.html"]) == 0
    said = capsys.readouterr()
    assert "the beam goes to x -0.50 to +0.50 m, y -0.50 to +0.50 m on the wall" in said.err
    assert ("PASS  watchdog" in said.out) == light
    assert ("with light" if light else "in the dark") in Path("page.html").read_text("utf-8")


def test_light_that_keeps_the_lasers_time_in_the_dark_is_a_leak(monkeypatch: pytest.MonkeyPatch) -> None:
    expose = SimulatedBench.expose

    def leaking(self: SimulatedBench, gate: Any) -> Any:
        before, self._shutter_open = self._shutter_open, True
        try:
            return expose(self, gate)
        finally:
            self._shutter_open = before

    monkeypatch.setattr(SimulatedBench, "expose", leaking)
    found = thorough(simulated(), light=False)
    assert found["dark histogram"].verdict == "FAIL"
    assert "laser light, with the shutter closed" in found["dark histogram"].said


def test_a_watchdog_that_does_not_bite_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Protection, "trip", lambda self, code: setattr(self, "tripped", code))
    assert thorough(simulated())["watchdog"].verdict == "FAIL"


def test_an_interlock_that_does_not_close_the_shutter_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Protection, "interlock_opened", False)
    assert thorough(simulated())["interlock"].verdict == "FAIL"


def test_a_head_slower_than_its_table_is_found() -> None:
    found = thorough(simulated(servo=ServoSettings(bandwidth_hz=150.0)))
    assert found["settling"].verdict == "FAIL"
    assert "its table says 3.5 ms" in found["settling"].said


def test_a_beam_that_stays_where_it_is_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedBench, "follow_path", lambda self, path, angles, when_s: None)
    found = thorough(simulated())
    assert found["corners"].verdict == "PASS", "the controller confirms every command"
    assert found["beam"].verdict == "FAIL"
    assert "does not follow" in found["beam"].said


def test_no_light_and_too_much_light_are_found() -> None:
    dim = simulated()
    assert dim.simulation is not None
    for direct_cps, verdict, word in ((0.0, "FAIL", "no light comes back"), (4e6, "WARN", "pile-up")):
        scene = dim.simulation.scene.model_copy(update={"direct_cps": direct_cps, "hidden_cps": 0.0})
        found = thorough(simulated(scene=scene, detector=DetectorSettings(dead_time_ns=0.0)))
        assert found["count rates"].verdict == verdict
        assert word in found["count rates"].said


def counts(widths: np.ndarray, mean: float = 2000.0) -> np.ndarray:
    return np.random.default_rng(4).poisson(widths * mean).astype(np.int64)


@pytest.mark.parametrize(
    ("shape", "verdict"),
    [
        (lambda n: np.ones(n), "PASS"),
        (lambda n: 1 + 0.08 * (-1.0) ** np.arange(n), "WARN"),
        (lambda n: 1 + 0.5 * (-1.0) ** np.arange(n), "FAIL"),
        (lambda n: 1 + 0.02 * np.sin(2 * np.pi * np.arange(n) / n), "WARN"),
        (lambda n: np.where(np.arange(n) == 77, 0.0, 1.0), "FAIL"),
    ],
    ids=["even", "odd and even", "worse", "bent", "a missing code"],
)
def test_code_density_tells_bins_that_differ_from_photon_noise(
    shape: Callable[[int], np.ndarray], verdict: str
) -> None:
    finding = judged(counts(shape(1024)), HistogramAxis(1024, 16e-12))
    assert finding.verdict == verdict, finding.said


def test_its_dnl_is_the_one_that_was_put_in() -> None:
    widths = 1 + 0.05 * np.random.default_rng(1).standard_normal(1024)
    said = judged(counts(widths, 5000.0), HistogramAxis(1024, 16e-12)).said
    found = re.match(r"DNL ([\d.]+)%", said)
    assert found is not None
    assert float(found[1]) == pytest.approx(5.0, abs=0.4)


def test_the_area_is_left_dark_by_whoever_is_stopped_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    benches: list[Bench] = []

    def agreed(bench: Bench) -> bool:
        benches.append(bench)
        return True

    def stopped(self: Any, seconds: float) -> None:
        raise KeyboardInterrupt

    findings = examine(replace(load_bench(None), settings=simulated()), Visit(agreed, None, thorough=True))
    while next(findings).what != "trip":
        pass
    monkeypatch.setattr(type(benches[0].clock), "sleep", stopped)
    with pytest.raises(KeyboardInterrupt):
        next(findings)
    monkeypatch.undo()
    assert benches[0].simulated is not None
    assert not benches[0].simulated.shutter_open


def test_without_anybody_there_what_takes_hands_is_skipped_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (dark_trials, shutter_trials, examination):
        monkeypatch.setattr(module, "hands_for", lambda bench: hands.NoHands())
    found = thorough(simulated())
    for line in ("linearity", "interlock", "cable"):
        assert found[line].verdict == "SKIP", line
        assert "no one is there" in found[line].said
    assert "replugged" not in found
    assert found["watchdog"].verdict == "PASS"


@pytest.mark.parametrize(("typed", "done"), [("", True), ("no", False), (None, False)])
def test_a_person_presses_enter_when_it_is_done(monkeypatch: pytest.MonkeyPatch, typed: str | None, done: bool) -> None:
    def answer() -> str:
        if typed is None:
            raise EOFError
        return typed

    monkeypatch.setattr(builtins, "input", answer)
    person = hands.PersonsHands()
    asked = (person.lamp(True), person.pull_mirror_cable(), person.replug(), person.ready_to_open_interlock())
    assert set(asked) == {done}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("off", "verdict", "said"),
    [
        ({}, "PASS", "at three places"),
        ({"scanner_x_m": 0.25}, "FAIL", "+0.250, +0.000 m from where it was sent"),
        ({"scanner_y_m": 0.03}, "WARN", "+0.000, +0.030 m"),
        ({"x_volts_per_degree": -0.5}, "FAIL", "x is reversed"),
        ({"y_volts_per_degree": -0.5}, "FAIL", "y is reversed"),
        ({"axes_swapped": True}, "FAIL", "x and y are swapped"),
    ],
)
def test_where_the_beam_goes_is_told_by_eye(off: dict[str, Any], verdict: str, said: str) -> None:
    found = thorough(simulated(misalignment=Misalignment(**off)))["aim"]
    assert (found.verdict, said in found.said) == (verdict, True), found


def test_a_person_marks_where_the_beam_came_and_it_is_dark_again(monkeypatch: pytest.MonkeyPatch) -> None:
    words = iter(["", "0.1, -0.05", "", "", "no"])
    monkeypatch.setattr(builtins, "input", lambda: next(words))
    person, opened_s = hands.PersonsHands(), []
    with open_bench(simulated()) as bench:
        assert bench.simulated is not None
        set_shutter = SimulatedBench.set_shutter
        monkeypatch.setattr(
            SimulatedBench, "set_shutter",
            lambda self, is_open: (opened_s.append((is_open, bench.clock.now())), set_shutter(self, is_open))[1],
        )  # fmt: skip
        assert person.spot(bench, (0.1, 0.0)) == (0.1, -0.05)
        assert not bench.simulated.shutter_open
        assert person.spot(bench, (0.1, 0.0)) is None  # lit, and not measured
        lit = [when for is_open, when in opened_s if is_open]
        dark = [when for is_open, when in opened_s if not is_open and when > lit[0]]
        assert dark[0] - lit[0] < 10.0
        assert person.spot(bench, (0.1, 0.0)) is None  # stays dark
        assert len([each for each, _ in opened_s if each]) == len(lit)


@pytest.mark.parametrize(("delay_ns", "said"), [(47.0, "none stands out at 16 of 16 points"), (93.0, "ns from where")])
def test_direct_light_is_looked_for_where_first_light_found_it(delay_ns: float, said: str) -> None:
    base = simulated()
    assert base.simulation is not None
    late = simulated(scene=base.simulation.scene.model_copy(update={"delay_ns": delay_ns, "ambient_cps": 20e3}))
    found = thorough(late)
    assert found["direct light"].verdict == "WARN"
    assert said in found["direct light"].said
    assert "calibrate --first-light" in found["direct light"].remedy
    assert found["beam"].verdict != "PASS"
    known = thorough(late.model_copy(update={"first_light": FirstLightSettings(delay_ns=delay_ns)}))
    assert [known[line].verdict for line in ("direct light", "beam", "settling", "count rates")] == ["PASS"] * 4
