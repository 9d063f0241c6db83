"""A mirror that plays by a clock of its own: every counter follows its marks, and each sample stays its own."""

import json
from typing import Any

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme, choose
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.helios.mirror import Helios
from nlos.drivers.galvo.helios.sequence import most_steps, own_steps, pace, samples_a_point
from nlos.drivers.simulated import instruments
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.coded_light import CodedLight, Spelled, code, expected, read

COUNTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "tcspc488": ("helios", {}),
    "tcspc488 t3": ("helios", {"mode": "t3"}),
    "multiharp": ("multiharp", {}),
    "timetagger": ("timetagger", {"pixel_clock": None, "mirror_steps": True}),
    "timetagger list": ("timetagger", {"pixel_clock": None, "mirror_steps": True, "mode": "list"}),
}


def settings(name: str, *faults: Fault, **mirror: Any) -> BenchSettings:
    """The helios bench with another counter; what has no shutter of its own is lit by the test."""
    text = load("bench", "helios", BenchSettings).settings.model_dump(mode="json")
    file, changes = COUNTERS[name]
    text["counter"] = load("bench", file, BenchSettings).settings.model_dump(mode="json")["counter"] | changes
    text["mirror"] |= mirror
    if not name.startswith("tcspc488"):
        text |= {"shutter": {"model": "none"}, "safety": {"watchdog_s": 0.0}}
    text["simulation"]["faults"] = [fault.model_dump(mode="json") for fault in faults]
    return BenchSettings.model_validate_json(json.dumps(text))


def plan(name: str, dwell_ms: float = 2.0, **changes: Any) -> ScanPlan:
    axis = {"bins": 512, "bin_width_ps": 40.0 if name == "multiharp" else 32.0, "offset_ns": 8.0}
    wall = {"width_m": 0.6, "height_m": 0.6, "rows": 6, "cols": 6}
    whole = {"wall": wall, "pattern": "serpentine", "dwell_ms": dwell_ms, "histogram": axis, **changes}
    return ScanSettings.model_validate(whole).plan()


@pytest.mark.parametrize("dwell_ms", [1.0, 2.0, 25.0, 200.0])
@pytest.mark.parametrize("name", COUNTERS)
def test_every_sample_of_every_counter_carries_its_own_points_code(
    name: str, dwell_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    this, chosen = plan(name, dwell_ms), settings(name)
    tells = name == "tcspc488"
    light = CodedLight(this.axis, chosen.laser.repetition_hz, tells)
    monkeypatch.setattr(instruments, "light_of", lambda settings, scene=None: light)
    with open_bench(chosen) as bench:
        angles = checked_angles(this, bench, aim_of(bench))
        if bench.simulated is not None and not name.startswith("tcspc488"):
            bench.simulated.set_shutter(True)
        samples = list(scan(this, bench, scheme=Scheme.PLAYED))
    assert [sample.point.number for sample in samples] == list(range(len(this)))
    per_code = 1.4 / 65536 / (2 * 0.698 / 4095)  # of the DAC's codes
    for sample in samples:
        due = expected(this, angles, sample.point.number, tells)
        told = read(sample.histogram.counts)
        assert abs(told.x - due.x) * per_code <= 1
        assert abs(told.y - due.y) * per_code <= 1
        assert Spelled(due.x, due.y, *[getattr(told, each) for each in list(Spelled.__dataclass_fields__)[2:]]) == due
        assert sample.histogram.live_time_s == pytest.approx(this[sample.point.number].dwell_s)


@pytest.mark.parametrize("line", ["marker_1", "marker_2", "trigger"])
@pytest.mark.parametrize("name", ["tcspc488", "tcspc488 t3"])
def test_a_mark_that_is_lost_on_its_way_moves_no_photons_to_another_point(
    name: str, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    this, chosen = plan(name), settings(name, Fault(name="H2", skip=4, parameters={"place": line}))
    light = CodedLight(this.axis, chosen.laser.repetition_hz, False)
    monkeypatch.setattr(instruments, "light_of", lambda settings, scene=None: light)
    with open_bench(chosen) as bench:
        angles = checked_angles(this, bench, aim_of(bench))
        samples = list(scan(this, bench))
    assert sorted(sample.point.number for sample in samples) == list(range(len(this)))
    for sample in samples:
        beam, told = angles[sample.point.number], read(sample.histogram.counts)
        assert abs(told.x - code(beam.x_rad)) < 20
        assert abs(told.y - code(beam.y_rad)) < 20


def test_without_the_cables_the_computer_steps_the_mirror() -> None:
    this = plan("tcspc488")
    for chosen in (settings("tcspc488", markers="none"), settings("tcspc488")):
        counter = chosen.counter.model_copy(update={"mirror_steps": False})
        with open_bench(chosen.model_copy(update={"counter": counter})) as bench:
            choice = choose(this, bench, checked_angles(this, bench, aim_of(bench)))
            assert choice.scheme is Scheme.STEPPED


def test_with_them_its_own_clock_does_where_that_is_faster() -> None:
    for dwell_ms, scheme in ((1.0, Scheme.PLAYED), (25.0, Scheme.PLAYED), (200.0, Scheme.STEPPED)):
        this = plan("tcspc488", dwell_ms)
        with open_bench(settings("tcspc488")) as bench:
            choice = choose(this, bench, checked_angles(this, bench, aim_of(bench)))
            assert choice.scheme is scheme


def test_points_that_stop_at_a_number_of_counts_are_stepped_by_the_computer() -> None:
    this = plan("tcspc488", exposure={"kind": "stop_at_counts", "counts": 100, "from_ns": 9.0, "to_ns": 20.0})
    with open_bench(settings("tcspc488")) as bench:
        choice = choose(this, bench, checked_angles(this, bench, aim_of(bench)))
    assert choice.scheme is Scheme.STEPPED
    assert "wait" in choice.why


@pytest.mark.parametrize("dwell_s", [20e-6, 122e-6, 1e-3, 8e-3, 25e-3, 0.2, 1.0, 10.0])
@pytest.mark.parametrize("settling_s", [0.0, 0.4e-3, 7.7e-3])
def test_a_step_of_its_clock_holds_settling_and_dwell_and_hardly_more(dwell_s: float, settling_s: float) -> None:
    steps = own_steps(dwell_s, settling_s)
    samples = samples_a_point(dwell_s)
    least_s = settling_s + dwell_s
    assert steps.blanking_s >= settling_s - 1e-12
    assert steps.blanking_s + dwell_s < steps.step_s - 2e-4 * dwell_s
    assert steps.step_s < max(1.02 * least_s + 20e-6, samples / wire.RATES[1] + 2e-6)
    assert most_steps(dwell_s) * samples <= wire.MOST_POINTS - 1
    assert round(steps.step_s * 112e6) % samples == 0  # processor cycles


def test_a_settling_that_its_clock_cannot_wait_for_is_refused() -> None:
    with pytest.raises(ValueError, match="fewer than 7"):
        pace(1e-3, 0.5)
    with open_bench(settings("tcspc488")) as bench:
        assert isinstance(bench.mirror, Helios)
        with pytest.raises(LimitError, match="fewer than 7"):
            bench.mirror.own_steps(1e-3, 0.5)
