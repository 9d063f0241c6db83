"""How long a series takes and how much disk, each scan checked as `nlos plan` does before the first one begins."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from nlos.acquisition.planning.preflight import aim_of, checked_angles, disk_bytes, fitted
from nlos.acquisition.planning.schemes import choose
from nlos.bench_constants import aiming_constants
from nlos.cli.benches import opened, twin
from nlos.drivers.errors import DeviceError
from nlos.drivers.trip_latch import check_before_light
from nlos.series.expand import Run


@dataclass(frozen=True)
class Forecast:
    """Of one scan."""

    points: int
    seconds: float
    disk_bytes: int
    scheme: str


def forecasts(runs: Sequence[Run], constants: Path | None) -> Iterator[Forecast]:
    """One for each run, in their order. Moves nothing: of a real bench the simulated twin is asked. Raises what a scan
    would raise, naming the run."""
    for _, group in itertools.groupby(runs, key=lambda run: run.bench.path):
        same = list(group)
        table = same[0].bench
        try:
            check_before_light(table.settings)
        except DeviceError as error:
            error.add_note(_before(same[0]))
            raise
        with opened(twin(table), quiet=True, logged=table.settings.simulated) as bench:
            known = aiming_constants(constants, same[0].bench.settings.model_dump_json(), {})
            measured = None if known is None else known.constants.geometry
            aim = aim_of(bench) if measured is None else measured
            for run in same:
                try:
                    plan = fitted(run.scan.settings.plan(), bench)
                    choice = choose(plan, bench, checked_angles(plan, bench, aim), aim=aim)
                except (ValueError, RuntimeError, OSError) as error:
                    error.add_note(_before(run))
                    raise
                yield Forecast(plan.most_samples, choice.forecast.total_s, disk_bytes(plan), choice.scheme.value)


def _before(run: Run) -> str:
    return f"in run {run.name}; no scan was begun"
