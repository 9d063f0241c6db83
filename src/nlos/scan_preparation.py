"""A scan before its light: everything checked, aimed and described, for the command line and from Python alike."""

import json
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.aim import Aiming
from nlos.acquisition.planning.direct_light import expected_direct, window_warnings
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, check_disk, checked_angles, fitted, refitted
from nlos.acquisition.planning.schemes import Choice, choose
from nlos.acquisition.recording.new_name import behind_link
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import Resumed
from nlos.acquisition.recording.salvage import resume as resumed
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.advice import Adviser
from nlos.acquisition.scanning.alarms import Alarms, AlarmSettings, Expected, free_bytes
from nlos.acquisition.scanning.control import ScanControl
from nlos.acquisition.scanning.direct_watch import DirectWatch
from nlos.acquisition.scanning.engine import scan
from nlos.acquisition.scanning.lag import Lag
from nlos.beam_seen import BeamJudged, judge_beam
from nlos.bench_constants import Known, aiming_constants
from nlos.drivers.bench import Bench
from nlos.drivers.bench_settings import BenchSettings


@dataclass(frozen=True)
class ScanRequest:
    """What somebody asks for. `header` holds the scan and bench files as given; without `target` nothing is written."""

    plan: ScanPlan
    alarms: AlarmSettings
    header: Header
    target: Path | None = None
    resume: bool = False
    overwrite: bool = False
    constants: Path | None = None
    """Of the bench, to aim by; None: the newest of this bench; `none`: none."""


@dataclass(frozen=True)
class PreparedScan:
    """A request that this bench can carry out, its plan on the counter's own time axis; nothing has moved and the light
    has been off."""

    request: ScanRequest
    bench: Bench
    header: Header
    constants: Known | None
    aim: Aiming
    lag: Lag | None
    choice: Choice
    alarms: Alarms
    warnings: tuple[str, ...] = ()
    """What is wrong with the plan's time window, and what nobody knows of where the beam goes."""

    def begin(self) -> Resumed:
        """The recording to write into. Raises `StorageError`, or `ResumeRefused`, where that cannot be."""
        asked = self.request
        assert asked.target is not None
        if asked.resume:
            return resumed(asked.target, asked.plan, self.header)
        made = RecordingWriter.create(asked.target, asked.plan, self.header, overwrite=asked.overwrite)
        return Resumed(made, {}, 0.0)

    def samples(
        self,
        begun: Resumed,
        control: ScanControl,
        decide: Callable[[], bool] | None = None,
        adviser: Adviser | None = None,
        decided: Sequence[int] = (),
    ) -> Generator[Sample, None, None]:
        """What is still missing, as it is taken."""
        if begun.taken:
            self.bench.scene_goes_on(begun.elapsed_s - begun.lit_s)
        return scan(
            self.request.plan, self.bench, aim=self.aim, taken=begun.taken, control=control, alarms=self.alarms,
            decide=decide, decided=decided, elapsed_s=begun.elapsed_s, lag=self.lag, adviser=adviser,
        )  # fmt: skip


def prepare(request: ScanRequest, bench: Bench) -> PreparedScan:
    """Checks trip, time axis, constants, limits, scheme and disk, in this order, then that there may be light. Raises
    `SafetyTrip`, `LimitError`, `ForeignConstants`, `PlanRefused` or `StorageError`; the bench is as it was then."""
    bench.shutter.check_trip()
    plan, target = fitted(request.plan, bench), request.target
    if other_axis := refitted(request.plan.axis, plan.axis):
        bench.report("warning", other_axis)
    request = replace(request, plan=plan)
    roles = {"mirror": bench.mirror.identity, "counter": bench.counter.identity}
    names = {role: who.name for role, who in roles.items()}
    known = aiming_constants(request.constants, bench.settings.model_dump_json(), names)
    if known is not None and known.warning:
        bench.report("warning", known.warning)
    geometry = None if known is None else known.constants.geometry
    aim = aim_of(bench) if geometry is None else geometry
    swept = request.resume and plan.within_px is not None and target is not None
    lag = known_lag(target) if swept and target is not None else None
    choice = choose(plan, bench, checked_angles(plan, bench, aim), lag=lag, aim=aim)
    if target is not None:
        check_disk(plan, target, round(request.alarms.min_free_mb * 1e6))
    folder = Path.cwd() if target is None else behind_link(target).absolute().parent
    own = bench.settings.with_own_first_light(names["counter"])
    direct = None if bench.settings.safety.dry_run else expected_direct(plan, own, aim)
    beam = BeamJudged() if direct is None else judge_beam(bench.settings, aim, by_spots=geometry is not None)
    warnings = () if direct is None else tuple(window_warnings(plan, direct))
    foreign = bench.settings.foreign_first_light(names["counter"])
    warnings = tuple(each for each in (foreign, *warnings, beam.warning) if each)
    for warning in warnings:
        bench.report("warning", warning)
    looks = None if direct is None else DirectWatch(plan, direct).look
    expected = Expected(looks, usual_dark_hz=usual_dark_hz(own), aim=beam.wrong)
    free = partial(free_to_end, target) if plan.until_stopped and target is not None else free_bytes
    alarms = Alarms(request.alarms, bench.settings.laser.repetition_hz, folder, free, expected)
    bench.shutter.agree()
    used = "{}" if known is None else json.dumps(known.constants.summary(), default=str)
    header = replace(
        request.header, devices=roles, warnings=(*bench.warnings, *warnings), constants_json=used
    ).stamped()
    return PreparedScan(request, bench, header, known, aim, lag, choice, alarms, warnings)


def free_to_end(target: Path, folder: Path) -> int:
    """Of the folder's disk, less what a film until it is stopped takes once more when it is cut to its frames."""
    taken = target.stat().st_blocks * 512 if target.exists() and hasattr(target.stat(), "st_blocks") else 0
    return free_bytes(folder) - taken


def usual_dark_hz(settings: BenchSettings) -> float | None:
    """What first light counted with the shutter closed; None where nobody covered the detector."""
    found = settings.first_light
    if found is None or found.dark_cps is None or found.room_cps is None:
        return None
    return found.dark_cps + found.room_cps


def known_lag(target: Path) -> Lag | None:
    """What a recording that is resumed was swept by; its further lines use the same, or its points are
    taken one by one as before."""
    if not target.exists():
        return None
    try:
        with Recording.open(target) as recording:
            said = [event.text for event in recording.events() if event.kind == "lag"]
            return Lag.of_text(said[0]) if said else None
    except InvalidData:
        return None
