"""Predicted durations are those of the bench, for every pattern and scheme, and learned where nobody knows."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import (
    ExpectedRates,
    aim_of,
    check_disk,
    check_light,
    checked_angles,
    disk_bytes,
    expectation,
)
from nlos.acquisition.planning.schemes import Scheme, forecast
from nlos.acquisition.planning.timing import Pace, clocked_forecast, learned_links, links_of, moves_s, stepped_forecast
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.alarms import Alarms, AlarmSettings
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.arm_settings import ArmSettings
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import LimitError

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]

PATTERNS: list[dict[str, Any]] = [
    {"kind": "raster"},
    {"kind": "serpentine"},
    {"kind": "subgrid", "rows": 7, "cols": 9},
    {"kind": "jittered", "rows": 10, "cols": 10},
    {"kind": "random", "points": 150},
    {"kind": "blue_noise", "points": 150},
    {"kind": "circle", "points": 120, "radius_m": 0.4},
    {"kind": "concentric_circles", "circles": 5, "points": 150},
    {"kind": "archimedean_spiral", "dr_m": 0.08},
    {"kind": "fermat_spiral", "dr_m": 0.09},
    {"kind": "coarse_to_fine"},
    {"kind": "coarse_to_fine", "batch": 16},
]


BENCH_OF = {
    Scheme.STEPPED: "simulated",
    Scheme.CLOCKED: "simulated",
    Scheme.LISTED: "multiharp",
    Scheme.PLAYED: "helios",
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("scheme", BENCH_OF)
@pytest.mark.parametrize("pattern", PATTERNS, ids=lambda pattern: "-".join(map(str, pattern.values())))
def test_predicted_time_is_within_2_percent_of_the_benches(
    bench_settings: Benches, small_plan: Plans, pattern: dict[str, Any], scheme: Scheme
) -> None:
    listed = scheme is Scheme.LISTED
    axis = {"bins": 64, "bin_width_ps": 320 if listed else 256, "offset_ns": 9.6}
    plan = small_plan(14, 14, pattern=pattern, histogram=axis)
    with open_bench(bench_settings(name=BENCH_OF[scheme])) as bench:
        angles = checked_angles(plan, bench, aim_of(bench))
        predicted = forecast(scheme, plan, bench, angles)
        started_s = bench.clock.now()
        for _ in scan(plan, bench, scheme=scheme):
            pass
        actual_s = bench.clock.now() - started_s
    assert predicted.dwell_s == pytest.approx(plan.dwell_total_s)
    assert predicted.total_s == pytest.approx(actual_s, rel=0.02)
    low_s, high_s = predicted.band_s
    assert low_s <= actual_s <= high_s


@pytest.mark.parametrize(
    ("name", "scheme", "slow_cable"),
    [
        *(
            (name, scheme, cable)
            for name, scheme in [
                ("simulated", Scheme.STEPPED),
                ("simulated", Scheme.CLOCKED),
                ("multiharp", Scheme.STEPPED),
                ("optotune", Scheme.STEPPED),
            ]
            for cable in ("serial_latency_ms", "usb_latency_ms", None)
        ),
        ("multiharp", Scheme.LISTED, None),
    ],
)
def test_scans_of_a_tenth_of_a_second_are_predicted_as_well(
    bench_settings: Benches, small_plan: Plans, name: str, scheme: Scheme, slow_cable: str | None
) -> None:
    """What a scan costs beyond its points, polled mirrors, slow cables."""
    settings = bench_settings(name=name)
    if slow_cable is not None:
        assert settings.simulation is not None
        slow = settings.simulation.model_copy(update={slow_cable: 4.0})
        settings = settings.model_copy(update={"simulation": slow})
    axis = {"bins": 64, "bin_width_ps": 320 if name == "multiharp" else 256, "offset_ns": 9.6}
    plan = small_plan(14, 14, pattern={"kind": "subgrid", "rows": 4, "cols": 7}, dwell_ms=2, histogram=axis)
    with open_bench(settings) as bench:
        predicted = forecast(scheme, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        alarms = Alarms(AlarmSettings(), settings.laser.repetition_hz)
        alarms.wait_for_rates(bench)
        started_s = bench.clock.now()
        assert len(list(scan(plan, bench, scheme=scheme, alarms=alarms))) == 28
        assert predicted.total_s == pytest.approx(bench.clock.now() - started_s, rel=0.02)


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
def test_the_time_between_batches_is_predicted_and_the_warning_time_before_light(
    bench_settings: Benches, small_plan: Plans, scheme: Scheme
) -> None:
    settings = bench_settings(name="simulated").model_copy(update={"arm": ArmSettings(delay_s=3.0, remote=True)})
    pattern = {"kind": "adaptive", "seconds": 0.5, "step_ms": 2.0, "lengths": 2, "batch": 10}
    plan = small_plan(12, 12, pattern=pattern, dwell_ms=2)
    with open_bench(settings) as bench:
        predicted = forecast(scheme, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        alarms = Alarms(AlarmSettings(), settings.laser.repetition_hz)
        alarms.wait_for_rates(bench)
        started_s = bench.clock.now()
        assert len(list(scan(plan, bench, scheme=scheme, alarms=alarms))) > 100
        actual_s = bench.clock.now() - started_s
    assert predicted.total_s - 3.0 == pytest.approx(actual_s - 3.0, rel=0.02)


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
def test_after_a_tenth_of_a_scan_its_end_is_known_within_5_percent(
    bench_settings: Benches, small_plan: Plans, scheme: Scheme
) -> None:
    """The mirror takes three times as long to settle as anybody told the planner, and cables are slow."""
    plan = small_plan(20, 20, pattern={"kind": "random", "points": 300, "seed": 4})
    settings = bench_settings(name="simulated")
    slow = settings.mirror.settle.model_copy(
        update={
            "table": tuple(
                point.model_copy(update={"settle_ms": 3 * point.settle_ms}) for point in settings.mirror.settle.table
            )
        }
    )
    with open_bench(settings) as bench:
        told_s = moves_s(bench, checked_angles(plan, bench, aim_of(bench)))
    pace = Pace(plan, told_s)
    settings = settings.model_copy(update={"mirror": settings.mirror.model_copy(update={"settle": slow})})
    with open_bench(settings) as bench:
        started_s, at_tenth = bench.clock.now(), (0.0, 0.0)
        for done, sample in enumerate(scan(plan, bench, scheme=scheme), 1):
            pace.step(sample)
            if done == len(plan) // 10:
                at_tenth = (sample.taken_s + sample.histogram.live_time_s, pace.remaining_s())
        actual_s = bench.clock.now() - started_s
    assert sum(at_tenth) == pytest.approx(actual_s, rel=0.05)


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
@pytest.mark.parametrize(
    "exposure",
    [
        {"kind": "two_pass", "counts": 700, "again_ms": 20},
        {"kind": "stop_at_counts", "counts": 50, "from_ns": 10.0, "to_ns": 26.0},
    ],
    ids=lambda exposure: exposure["kind"],
)
def test_where_the_light_decides_the_band_holds_what_it_decided(
    bench_settings: Benches, small_plan: Plans, exposure: dict[str, Any], scheme: Scheme
) -> None:
    plan = small_plan(10, 10, exposure=exposure)
    with open_bench(bench_settings(name="simulated")) as bench:
        predicted = forecast(scheme, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        started_s = bench.clock.now()
        taken = len(list(scan(plan, bench, scheme=scheme)))
        actual_s = bench.clock.now() - started_s
    low_s, high_s = predicted.band_s
    assert taken < len(plan) or plan.stop is not None
    assert low_s < actual_s < high_s


@pytest.mark.parametrize("mode", ["histogram", "t3"])
@pytest.mark.parametrize("pause_s", [0.0, 3600.0], ids=["in one go", "resumed an hour later"])
def test_links_are_learned_from_a_past_scan(
    bench_settings: Benches, small_plan: Plans, pause_s: float, mode: str
) -> None:
    """A pause between two points teaches nothing of them; in list mode a point that is sorted out of photons is known
    to be complete later, which is learned with the rest and not counted again."""
    plan, chosen = small_plan(10, 10), bench_settings(name="simulated")
    counter = chosen.counter.model_copy(update={"mode": mode})
    with open_bench(chosen.model_copy(update={"counter": counter})) as bench:
        assert bench.counter.list_mode == (mode == "t3")
        angles = checked_angles(plan, bench, aim_of(bench))
        samples = list(scan(plan, bench, scheme=Scheme.STEPPED))
        true = links_of(bench)
        samples[40:] = [replace(each, taken_s=each.taken_s + pause_s) for each in samples[40:]]
        learned = learned_links(replace(true, move_s=0.0, margin=0.15), samples, Pace(plan, moves_s(bench, angles)))
        told = [stepped_forecast(plan, bench, angles, each).total_s for each in (learned, true)]
    assert learned.move_s == pytest.approx(true.move_s, rel=0.02)
    assert told[0] == pytest.approx(told[1], rel=0.005)


def test_of_a_scan_with_too_few_points_nothing_is_learned(bench_settings: Benches, small_plan: Plans) -> None:
    """Cables would cost no time at all by it, within two per cent."""
    plan = small_plan(4, 4)
    with open_bench(bench_settings(name="simulated")) as bench:
        angles = checked_angles(plan, bench, aim_of(bench))
        samples = list(scan(plan, bench, scheme=Scheme.STEPPED))
        known = replace(links_of(bench), margin=0.15)
        assert learned_links(known, samples, Pace(plan, moves_s(bench, angles))) == known


def test_a_disk_without_room_is_refused(small_plan: Plans, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(100, 100)
    assert disk_bytes(plan) == pytest.approx(100 * 100 * (64 * 4 + 51 + 36), rel=0.5)  # counts, a record, the plan
    check_disk(plan, tmp_path / "run.h5")
    huge = ScanPlan(plan.wall, plan.axis.__class__(65536, 16e-12), plan.positions, plan.dwell_s, plan.pass_)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": 10**9})())
    with pytest.raises(StorageError, match=r"needs 262\d\.\d MB, the disk has 1000 MB"):
        check_disk(huge, tmp_path / "run.h5")


def test_rates_learned_from_a_recording_predict_counts_and_refuse_pile_up(
    bench_settings: Benches, small_plan: Plans, run_path: Path
) -> None:
    axis = {"bins": 1024, "bin_width_ps": 64, "offset_ns": 10}
    plan = small_plan(8, 8, histogram=axis)
    with (
        open_bench(bench_settings(name="simulated")) as bench,
        RecordingWriter.create(run_path, plan, Header()) as writer,
    ):
        record(scan(plan, bench), writer)
    with Recording.open(run_path) as recording:
        rates = ExpectedRates.of_recording(recording)
        counts = np.array([s.histogram.counts.sum() for s in recording.samples()])
    assert rates.direct_hz == pytest.approx(40e3, rel=0.25)
    assert rates.background_hz == pytest.approx(600 * 65.5e-9 * 10e6, rel=0.6)
    expected = expectation(plan, rates)
    assert expected.direct + expected.indirect + expected.background == pytest.approx(counts.mean(), rel=0.01)
    with open_bench(bench_settings(name="simulated")) as bench:
        assert bench.simulated is not None
        angles = checked_angles(plan, bench, aim_of(bench))
        simulated = ExpectedRates.of_simulation(plan, bench, angles)
        assert not bench.simulated.shutter_open
    assert simulated.total_hz == pytest.approx(rates.total_hz, rel=0.15)
    longer = expectation(small_plan(8, 8, dwell_ms=32), rates)
    assert longer.signal_to_noise == pytest.approx(2 * expected.signal_to_noise, rel=1e-6)
    check_light(rates, 10e6)
    with pytest.raises(LimitError, match=r"pile-up.*Attenuate"):
        check_light(rates, 1e6)


def test_planning_takes_as_long_as_there_are_points(
    bench_settings: Benches, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of very many frames each point is looked at once, and each place checked once."""
    looks, checks, whole = [], [], ScanPlan.__getitem__
    monkeypatch.setattr(ScanPlan, "__getitem__", lambda plan, number: looks.append(number) or whole(plan, number))
    plan = small_plan(4, 4, frames=300)
    with open_bench(bench_settings(name="simulated")) as bench:
        known = bench.mirror.check
        monkeypatch.setattr(bench.mirror, "check", lambda angles: checks.append(angles) or known(angles))
        clocked_forecast(plan, bench, checked_angles(plan, bench, aim_of(bench)), links_of(bench))
    assert len(looks) <= 1.1 * len(plan)
    assert len(checks) <= 100
