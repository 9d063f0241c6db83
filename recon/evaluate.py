"""Methods on scenes with ground truth: every method under every condition, each physics method at its best snr."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from nlos.acquisition.transient import Transient
from nlos.recon.entrants import Entrant, check_known, choices, entrant, learned_from, unlike_trained
from nlos.recon.errors import NO_PICTURE, InvalidData, InvalidSettings
from nlos.recon.fingerprint import fingerprint_of
from nlos.recon.interval_scores import interval_scores
from nlos.recon.methods import find
from nlos.recon.metrics import depth_scores, image_scores
from nlos.recon.peak_memory import forget_peak, peak_rss_mb
from nlos.recon.reconstruct import reconstruct
from nlos.recon.truth_checks import turned_truth
from nlos.recon.truth_scenes import Say, Scene, datasets, find_scenes, has_condition, transient_of
from nlos.recon.volume import Reconstruction, response_words

CONDITIONS = ("transient", "counts_p20", "counts_p5", "counts_p1", "counts_p5@16x16")


@dataclass(frozen=True)
class Row:
    """One scene, method and condition: the scores and what they cost."""

    scene: str
    method: str
    settings: dict[str, Any]
    condition: str
    psnr: float
    ssim: float
    psnr_max: float
    ssim_max: float
    corr: float
    depth_rmse_m: float
    depth_mad_m: float
    depth_median_abs_m: float
    depth_missing: float
    seconds: float
    peak_rss_mb: float
    explained: float = float("nan")
    """The share of light that the picture accounts for, and its standard error; NaN where that could not be found."""
    explained_error: float = float("nan")
    albedo_coverage: float = float("nan")
    """From here on see `interval_scores.interval_scores`; NaN of methods that do not know how sure they are."""
    albedo_width: float = float("nan")
    albedo_ause: float = float("nan")
    depth_coverage: float = float("nan")
    depth_width_m: float = float("nan")
    depth_ause: float = float("nan")
    seen_ece: float = float("nan")


@dataclass(frozen=True)
class Without:
    """A method that made no picture of a scene under a condition, and why."""

    scene: str
    method: str
    condition: str
    error: Exception

    @property
    def why(self) -> str:
        return str(self.error) or "the memory is not enough"  # of which Python's own error says nothing

    def __str__(self) -> str:
        return f"{self.scene}, {self.condition}, {self.method}: no result: {self.why}"


@dataclass(frozen=True)
class Evaluation:
    """All rows, the scenes, and the front view and depth behind each row."""

    rows: list[Row]
    scenes: list[Scene]
    pictures: dict[tuple[str, str, str], Reconstruction]  # (scene, method, condition), without volumes
    notes: list[str] = field(default_factory=list)
    """What to know before believing a figure."""
    without: list[Without] = field(default_factory=list)
    """What has no row."""


Run = tuple[Row, Reconstruction]


def evaluate(
    paths: Sequence[Path],
    methods: Sequence[str],
    conditions: Sequence[str] = CONDITIONS,
    *,
    settings: dict[str, object] | None = None,
    fixed: bool = False,
    device: str = "cpu",
    response: Callable[[Transient], Transient] = lambda transient: transient,
    say: Say = print,
    step: Callable[[int, int, str], None] = lambda done, total, at: None,
) -> Evaluation:
    """Runs every method on every scene under every condition; conditions that a scene lacks are skipped and reported.

    A physics method with an inverse filter runs at each of `SNR_CHOICES` and keeps, per condition, the one with the
    best mean psnr; `fixed` leaves its snr to the method. `settings` go to every method that knows them. A word of
    `methods` may be a method's file, or `NAME=FILE`: such a file, or weights, which say their method. `response` may
    put another response in place of the file's or the condition's. `step(done, total, at)` is called after every
    reconstruction. A method that fails on a scene under a condition is excluded there, and the others go on: see
    `Evaluation.without`. Raises `InvalidData` where no scene has a truth, `InvalidSettings` for a method or condition
    that does not exist and for two scenes of one name, and what the first one raised where none made any picture.
    """
    entrants = [entrant(word) for word in methods]
    if twice := sorted({one.name for one in entrants if [e.name for e in entrants].count(one.name) > 1}):
        raise InvalidSettings(f"{', '.join(twice)}: named twice. Give each of them a name of its own, as NAME=FILE.")
    check_known([one.method for one in entrants], settings or {})
    scenes = _scenes(paths, say)
    _check_conditions(scenes, conditions, response)
    notes = [
        f"{one.name} has learned from {scene.name}: its figures there say nothing about other scenes"
        for one in entrants
        for scene in scenes_learned_from(one, scenes)
    ]
    for note in notes:
        say(note)
    runs, without = list[Run](), list[Without]()
    tried = {one.name: choices(one.method, settings or {}, fixed, one.settings) for one in entrants}
    count = sum(has_condition(scene, condition) for scene in scenes for condition in conditions)
    course = _Course(say, step, count * sum(map(len, tried.values())))
    for condition in conditions:
        having = [scene for scene in scenes if has_condition(scene, condition)]
        if len(having) < len(scenes):
            say(f"{condition}: only in {', '.join(scene.name for scene in having)}")
        measured = _Measured(condition, [(scene, response(transient_of(scene, condition))) for scene in having])
        for one in entrants:
            if unlike := unlike_trained(one, measured.scans[0][1], having[0].falloff):
                notes.append(f"{one.name}, {condition}: {unlike}")
                say(notes[-1])
            best, failed = _best_runs(one, measured, tried[one.name], device, course)
            runs += best
            without += failed
    if not runs:
        raise type(without[0].error)(str(without[0])) from without[0].error
    notes += map(str, without)
    for scene in scenes:
        if said := turned_truth([made.albedo for row, made in runs if row.scene == scene.name], scene.intensity):
            notes.append(f"{scene.name}: {said}")
            say(notes[-1])
    pictures = {(row.scene, row.method, row.condition): made for row, made in runs}
    return Evaluation([row for row, _ in runs], scenes, pictures, notes, without)


@dataclass(frozen=True)
class _Measured:
    """The scenes that have a condition, each with what was measured under it."""

    condition: str
    scans: list[tuple[Scene, Transient]]


@dataclass
class _Course:
    """Who hears of what, and of how much is done."""

    say: Say
    step: Callable[[int, int, str], None]
    total: int
    done: int = 0

    def after(self, at: str) -> None:
        """One reconstruction more was made, or failed."""
        self.done += 1
        self.step(self.done, self.total, at)


def _scenes(paths: Sequence[Path], say: Say) -> list[Scene]:
    """Raises `InvalidData` where no file has a truth, `InvalidSettings` for two scenes of one name."""
    scenes = list(find_scenes(paths, say))
    if not scenes:
        raise InvalidData(
            f"no scene with ground truth (gt_intensity, gt_depth, gt_mask) in {', '.join(map(str, paths))}. To compare "
            "methods on a scan without one: `nlos reconstruct` by each, then `nlos figure DIR DIR ... -o both.png`."
        )
    for scene, other in combinations(scenes, 2):
        if scene.name == other.name:
            raise InvalidSettings(
                f"{scene.path} and {other.path}: are two scenes of one name, by which figures and pictures are told "
                "apart. Name each file once, rename one of them, or evaluate them apart."
            )
    return scenes


def _check_conditions(
    scenes: Sequence[Scene], conditions: Sequence[str], response: Callable[[Transient], Transient]
) -> None:
    """Raises for conditions that no scene has and for what cannot be used: before hours of work, not after."""
    for condition in conditions:
        if not any(has_condition(scene, condition) for scene in scenes):
            known = ", ".join(sorted(datasets(scenes[0])))
            raise InvalidSettings(f"no scene has the condition '{condition}'; {scenes[0].name} has: {known}")
        for scene in scenes:
            if has_condition(scene, condition):
                response(transient_of(scene, condition))


def _best_runs(
    one: Entrant, measured: _Measured, tried: Sequence[dict[str, object]], device: str, course: _Course
) -> tuple[list[Run], list[Without]]:
    """By the settings of the best mean psnr, over the scenes that none of the settings failed on; and the others."""
    best: list[Run] = []
    failed: dict[str, Without] = {}
    for chosen in tried:
        runs = []
        for scene, transient in measured.scans:
            try:
                if scene.name not in failed:
                    runs.append(_run(scene, transient, one, chosen, measured.condition, device))
            except (*NO_PICTURE, MemoryError) as error:
                failed[scene.name] = Without(scene.name, one.name, measured.condition, error)
                course.say(str(failed[scene.name]))
            course.after(f"{measured.condition}, {one.name}, {scene.name}")
        best = [run for run in best if run[0].scene not in failed]
        if not best or _mean_psnr(runs) > _mean_psnr(best):
            best = runs
    if best:
        mean = f"{measured.condition:18} {one.name:16} psnr {_mean_psnr(best):6.2f} dB"
        course.say(mean + _tried(best[0][0]))
    return best, list(failed.values())


def scenes_learned_from(one: Entrant, scenes: Sequence[Scene]) -> list[Scene]:
    """The scenes that an entrant's weights were trained on, told by what they show and not by their names."""
    seen = learned_from(one)
    return (
        [scene for scene in scenes if fingerprint_of(scene.intensity, scene.depth_m * scene.mask) in seen]
        if seen
        else []
    )


def _run(
    scene: Scene, transient: Transient, one: Entrant, settings: dict[str, object], condition: str, device: str
) -> Run:
    if scene.falloff is not None and "falloff" in find(one.method).Settings.model_fields:
        settings = {"falloff": scene.falloff, **settings}
    forget_peak()
    done = reconstruct(transient, one.method, settings, device)
    told, nan = done.explained, float("nan")
    row = Row(
        scene=scene.name,
        method=one.name,
        settings=done.settings | ({} if done.response is None else {"response": response_words(done)}),
        condition=condition,
        **image_scores(done.albedo, scene.intensity),
        **depth_scores(done.depth_m, scene.depth_m, scene.mask),
        explained=nan if told is None or told.share is None else told.share,
        explained_error=nan if told is None or told.error is None else told.error,
        **interval_scores(done.albedo, done.depth_m, done.intervals, scene.intensity, scene.depth_m, scene.mask),
        seconds=done.seconds,
        peak_rss_mb=peak_rss_mb(),
    )
    light = Reconstruction(done.albedo, done.depth_m, done.wall, done.method, done.seconds, done.settings)
    return row, light


def _tried(row: Row) -> str:
    return "" if row.settings.get("snr") is None else f"  at snr {row.settings['snr']:g}"


def _mean_psnr(runs: list[Run]) -> float:
    return float(np.mean([row.psnr for row, _ in runs]))


def as_json(rows: list[Row]) -> list[dict[str, Any]]:
    """The rows as plain values; NaN (no depth at all) becomes null."""
    return [{key: None if value != value else value for key, value in asdict(row).items()} for row in rows]
