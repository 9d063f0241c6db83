"""The sync input of PicoQuant counters: a laser that is faster than it, what its divider does, what is said of it."""

import json

import pytest
from pydantic import ValidationError

from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.errors import LimitError
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.picoquant.histogram import Picoquant

AXIS = HistogramAxis(512, 64e-12)


def lit(device: str, laser_hz: float, mode: str, divider: int = 1) -> Picoquant:
    """A counter that sees the laser's direct light, 13.34 ns after the pulse, and nothing else."""
    detector = DetectorSettings(dead_time_ns=0.0, dark_cps=0.0)
    scene = SceneSettings(direct_cps=1e6, ambient_cps=0.0)
    bench = SimulatedBench(SceneLight(scene, detector, BeamPath(2.0), laser_hz, seed=3))
    bench.set_shutter(True)
    return open_picoquant(
        block(device, mode=mode, sync_divider=divider), bench.clock, PicoquantLibrary(bench, device, laser_hz)
    )


def block(device: str, **more: object) -> PicoquantSettings:
    return PicoquantSettings.model_validate({"model": "picoquant", "device": device, "library": "simulated", **more})


@pytest.mark.parametrize(
    ("device", "sync_hz", "fits", "misfits"),
    [
        ("picoharp300", 78e6, 8, 4), ("picoharp300", 100e6, None, 8), ("picoharp300", 0.1e6, 1, 2),
        ("hydraharp400", 80e6, 8, 4), ("multiharp150", 80e6, 2, 1), ("multiharp150", 100e6, 2, 1),
    ],
)  # fmt: skip
def test_a_bench_file_whose_laser_and_sync_divider_do_not_go_together_is_refused(
    device: str, sync_hz: float, fits: int | None, misfits: int
) -> None:
    """Whatever a rate meter would say: that of an input which misses pulses counts those that are left."""
    counter = block(device, sync_divider=misfits)
    wanted = "Divide the sync signal" if fits is None else f"Set sync_divider: {fits}"
    assert f"{sync_hz / 1e6:.6g} MHz" in counter.laser_misfit(sync_hz)
    assert wanted in counter.laser_misfit(sync_hz)
    bench = load("bench", "multiharp", BenchSettings).settings.model_dump(mode="json", exclude_none=True)
    bench |= {"counter": counter.model_dump(mode="json"), "laser": {"repetition_hz": sync_hz}}
    with pytest.raises(ValidationError, match=wanted):
        BenchSettings.model_validate_json(json.dumps(bench))
    if fits is not None:
        bench["counter"] |= {"sync_divider": fits, **PicoquantSettings.laser_keys(sync_hz, device)}
        assert BenchSettings.model_validate_json(json.dumps(bench)).counter.sync_divider == fits


@pytest.mark.parametrize(("device", "laser_hz", "every"), [("picoharp300", 40e6, 4), ("hydraharp400", 80e6, 7)])
@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_pulses_that_a_sync_input_is_too_slow_for_are_missed_and_that_is_noticed(
    device: str, laser_hz: float, every: int, mode: str
) -> None:
    """By its dead time, 95 and 80 ns. Its rate meter alone tells of nothing: it counts those that are left."""
    counter = lit(device, laser_hz, mode)
    assert counter.rates().sync_hz == pytest.approx(laser_hz / every, abs=1)
    with pytest.raises(LimitError, match=f"{laser_hz / 1e6:g} MHz.*Set sync_divider: {4 if laser_hz < 50e6 else 8}"):
        counter.configure(AXIS)


@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_what_a_too_slow_sync_input_records_is_the_light_of_several_pulses_one_behind_the_other(
    mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Picoquant, "_check_sync", lambda self, sync_hz: None)
    counter = lit("picoharp300", 40e6, mode)
    counter.configure(HistogramAxis(1600, 64e-12))  # 102.4 ns: four periods of the laser
    counter.arm(PointGates([8e-3], [0]))
    counter.trigger()
    counter.wait_points(1, 1.0)
    (histogram,) = counter.read(0, 1)
    assert histogram.sync_count == 80_000  # of 320 000
    assert histogram.total_count > 7_000
    for pulse in range(4):
        at = round((13.343e-9 + pulse * 25e-9) / 64e-12)
        assert histogram.counts[at - 5 : at + 40].sum() / histogram.total_count == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize(("divider", "calls"), [(1, 1), (2, 1), (16, 0)])
def test_a_divider_is_compared_with_the_largest_once_for_each_rate(divider: int, calls: int) -> None:
    counter, set_to = lit("multiharp150", 10e6, "t3", divider), []
    call = counter._library.call

    def heard(name: str, *arguments: object) -> int:
        if name == "SetSyncDiv":
            set_to.append(arguments[0])
        return call(name, *arguments)

    counter._library.call = heard
    for laser_hz in (10e6, 20e6):
        counter._library._functions._sync._laser_hz = laser_hz
        for _ in range(3):
            counter.configure(HistogramAxis(512, 40e-12))
            counter.arm(PointGates([8e-3], [0]))
        assert set_to == ([16, divider] * calls if laser_hz > 10e6 else [])  # at 10 MHz: as it was opened
