"""Light comes when `arm.delay_s` announced it, however long what had to be made ready took."""

from pathlib import Path

import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.salvage import Resumed
from nlos.acquisition.scanning.alarms import AlarmSettings
from nlos.acquisition.scanning.control import ScanControl
from nlos.configs.load import load
from nlos.drivers.arm_settings import ArmSettings
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.scan_preparation import PreparedScan, ScanRequest, prepare

WARNING_S, PAGE_S = 5.0, 30.0
EXCHANGES_S = 0.02
"""Of opening a shutter, watchdog armed and read back."""
STEPS = {"wall": {"width_m": 0.6, "height_m": 0.6, "rows": 3, "cols": 3}, "pattern": "serpentine", "dwell_ms": 8,
         "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 8}}  # fmt: skip
LINES = {**STEPS, "wall": {"width_m": 0.6, "height_m": 0.6, "rows": 4, "cols": 64}, "dwell_ms": 0.122,
         "continuous": {"within_pixels": 0.25}}  # fmt: skip


def _settings(name: str) -> BenchSettings:
    warned = {"arm": ArmSettings(delay_s=WARNING_S, remote=True)}
    return load("bench", name, BenchSettings).settings.model_copy(update=warned)


def _prepared(bench: Bench, scan: dict[str, object]) -> PreparedScan:
    plan = ScanSettings.model_validate(scan).plan()
    return prepare(ScanRequest(plan, AlarmSettings(), Header(), constants=Path("none")), bench)


def _witnessed(bench: Bench) -> tuple[list[float], list[float]]:
    """When light was announced, and when the table's shutter opened."""
    announced: list[float] = []
    opened: list[float] = []
    assert bench.simulated is not None
    bench.on_event = lambda kind, text: announced.append(bench.clock.now()) if text.startswith("light in") else None
    bench.simulated.witness = lambda when_s, what: opened.append(when_s) if what == "shutter open" else None
    return announced, opened


@pytest.mark.parametrize(
    ("name", "scan"), [("optotune", STEPS), ("simulated", STEPS), ("multiharp", STEPS), ("simulated", LINES)]
)
def test_light_comes_when_it_was_announced_whatever_was_made_ready_before(name: str, scan: dict[str, object]) -> None:
    with open_bench(_settings(name)) as bench:
        announced, opened = _witnessed(bench)
        prepared = _prepared(bench, scan)
        assert not announced
        bench.clock.sleep(PAGE_S)  # a live page, a recording on a slow share
        samples = prepared.samples(Resumed(None, {}, 0.0), ScanControl())
        next(samples)
        samples.close()
    assert len(announced) == 1
    assert WARNING_S <= opened[0] - announced[0] < WARNING_S + EXCHANGES_S


def test_a_forecast_knows_of_the_warning_time() -> None:
    with open_bench(load("bench", "simulated", BenchSettings).settings) as bench:
        without_s = _prepared(bench, STEPS).choice.forecast.total_s
    with open_bench(_settings("simulated")) as bench:
        prepared = _prepared(bench, STEPS)
        began_s = bench.clock.now()
        list(prepared.samples(Resumed(None, {}, 0.0), ScanControl()))
        assert bench.clock.now() - began_s == pytest.approx(prepared.choice.forecast.total_s, abs=0.2)
    assert prepared.choice.forecast.total_s == pytest.approx(without_s + WARNING_S)


def test_a_signal_in_the_warning_time_breaks_it_off_and_who_goes_on_is_warned_anew() -> None:
    with open_bench(_settings("simulated")) as bench:
        announced, opened = _witnessed(bench)
        asked: list[float] = []
        signals: list[int] = []
        control = ScanControl(lambda why: asked.append(bench.clock.now()) is None)
        prepared, sleep = _prepared(bench, STEPS), bench.clock.sleep

        def signalled(seconds: float) -> None:  # as the handler of Ctrl-C does it, from within whatever waits
            sleep(seconds)
            if announced and not signals and bench.clock.now() - announced[0] > 1.0:
                signals.append(2)
                control.interrupt("Ctrl-C in the terminal")
                bench.shutter.hold("SIGINT")

        bench.clock.sleep = signalled  # type: ignore[method-assign]
        next(samples := prepared.samples(Resumed(None, {}, 0.0), control))
        samples.close()
    assert len(asked) == 1
    assert asked[0] - announced[0] < 1.3  # not at the end of the warning time
    assert len(announced) == 2
    assert WARNING_S <= opened[0] - announced[1] < WARNING_S + EXCHANGES_S
