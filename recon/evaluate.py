"""Methods on scenes with ground truth: every method under every condition, each physics method at its best snr.

A scene is a plain HDF5 scan with histograms [H, W, T] under the conditions' names (`transient`, `counts_p20` ...), its
attributes as in `acquisition/importers/plain.py`, and the truth on the same grid: `gt_intensity`, `gt_depth` (m),
`gt_mask`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.isolated import check_isolated
from nlos.acquisition.importers.plain import grid_of, read_plain
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, needed_array, open_hdf5
from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.conditions import NOISELESS, parsed, slowed
from nlos.recon.entrants import Entrant, check_known, choices, entrant, learned_from, unlike_trained
from nlos.recon.errors import NO_PICTURE, InvalidData, InvalidSettings
from nlos.recon.fingerprint import fingerprint_of
from nlos.recon.interval_scores import interval_scores
from nlos.recon.methods import find
from nlos.recon.metrics import depth_scores, image_scores
from nlos.recon.peak_memory import forget_peak, peak_rss_mb
from nlos.recon.reconstruct import reconstruct
from nlos.recon.subsets import measured_points
from nlos.recon.truth_checks import check_reach, checked_depth, turned_truth
from nlos.recon.volume import Reconstruction, response_words

CONDITIONS = ("transient", "counts_p20", "counts_p5", "counts_p1", "counts_p5@16x16")
Say = Callable[[str], None]


@dataclass(frozen=True)
class Scene:
    """A file's truth, and where its measurements are."""

    name: str
    path: Path
    intensity: npt.NDArray[np.float32]  # (H, W)
    depth_m: npt.NDArray[np.float32]  # (H, W), 0 = background
    mask: npt.NDArray[np.bool_]  # (H, W)
    wall: WallGrid
    falloff: int | None
    """The exponent that the file says, for methods that have one."""


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
class Evaluation:
    """All rows, the scenes, and the front view and depth behind each row."""

    rows: list[Row]
    scenes: list[Scene]
    pictures: dict[tuple[str, str, str], Reconstruction]  # (scene, method, condition), without volumes
    notes: list[str] = field(default_factory=list)
    """What to know before believing a figure."""


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
    reconstruction. Raises `InvalidData` where no scene has a truth, `InvalidSettings` for a method or condition that
    does not exist.
    """
    entrants = [entrant(word) for word in methods]
    if twice := sorted({one.name for one in entrants if [e.name for e in entrants].count(one.name) > 1}):
        raise InvalidSettings(f"{', '.join(twice)}: named twice. Give each of them a name of its own, as NAME=FILE.")
    check_known([one.method for one in entrants], settings or {})
    scenes = list(find_scenes(paths, say))
    if not scenes:
        raise InvalidData(
            f"no scene with ground truth (gt_intensity, gt_depth, gt_mask) in {', '.join(map(str, paths))}. To compare "
            "methods on a scan without one: `nlos reconstruct` by each, then `nlos figure DIR DIR ... -o both.png`."
        )
    for condition in conditions:
        if not any(has_condition(scene, condition) for scene in scenes):
            known = ", ".join(sorted(datasets(scenes[0])))
            raise InvalidSettings(f"no scene has the condition '{condition}'; {scenes[0].name} has: {known}")
    notes = [
        f"{one.name} has learned from {scene.name}: its figures there say nothing about other scenes"
        for one in entrants
        for scene in scenes_learned_from(one, scenes)
    ]
    for note in notes:
        say(note)
    rows, pictures = [], {}
    each = sum(len(choices(one.method, settings or {}, fixed, one.settings)) for one in entrants)
    done, total = 0, len(conditions) * len(scenes) * each
    for condition in conditions:
        having = [scene for scene in scenes if has_condition(scene, condition)]
        if len(having) < len(scenes):
            say(f"{condition}: only in {', '.join(scene.name for scene in having)}")
            total -= each * (len(scenes) - len(having))
        transients = [response(transient_of(scene, condition)) for scene in having]
        for one in entrants:
            if unlike := unlike_trained(one, transients[0], having[0].falloff):
                notes.append(f"{one.name}, {condition}: {unlike}")
                say(notes[-1])
            best: list[tuple[Row, Reconstruction]] = []
            for chosen in choices(one.method, settings or {}, fixed, one.settings):
                runs = []
                for scene, transient in zip(having, transients, strict=True):
                    runs.append(_run(scene, transient, one, chosen, condition, device))
                    done += 1
                    step(done, total, f"{condition}, {one.name}, {scene.name}")
                if not best or _mean_psnr(runs) > _mean_psnr(best):
                    best = runs
            say(f"{condition:18} {one.name:16} psnr {_mean_psnr(best):6.2f} dB{_tried(best[0][0])}")
            for row, picture in best:
                rows.append(row)
                pictures[row.scene, row.method, row.condition] = picture
    for scene in scenes:
        if said := turned_truth(
            [made.albedo for key, made in pictures.items() if key[0] == scene.name], scene.intensity
        ):
            notes.append(f"{scene.name}: {said}")
            say(notes[-1])
    return Evaluation(rows, scenes, pictures, notes)


def scenes_learned_from(one: Entrant, scenes: Sequence[Scene]) -> list[Scene]:
    """The scenes that an entrant's weights were trained on, told by what they show and not by their names."""
    seen = learned_from(one)
    return (
        [scene for scene in scenes if fingerprint_of(scene.intensity, scene.depth_m * scene.mask) in seen]
        if seen
        else []
    )


def find_scenes(paths: Sequence[Path], say: Say) -> Iterator[Scene]:
    """Every scene with a truth among files and folders, in the order of their names; the others are said."""
    for path in paths:
        if not path.exists():
            raise InvalidData(f"{path} does not exist.")
        for file in sorted(path.glob("*.h5")) if path.is_dir() else [path]:
            check_isolated(file, "nlos.acquisition.importers.untrusted_hdf5:read_everything")
            scene = read_scene(file)
            if scene is None:
                say(f"{file.name}: no ground truth, skipped")
            else:
                yield scene


def read_scene(path: Path) -> Scene | None:
    """The scene in `path`, or None where it has no truth. Raises `InvalidData` where its truth cannot be used."""
    try:
        with open_hdf5(path) as file:
            if not {"gt_intensity", "gt_depth", "gt_mask"} <= set(file):
                return None
            intensity, depth_m, mask = (
                needed_array(file, name, (None, None)) for name in ("gt_intensity", "gt_depth", "gt_mask")
            )
            sizes = np.atleast_1d(np.asarray(file.attrs["wall_size_m"], dtype=np.float64))
            wall = WallGrid(float(sizes[0]), float(sizes[-1]), *intensity.shape)
            falloff = file.attrs.get("falloff_exponent_authors")
            places = grid_of(path, file, intensity.shape)
    except (OSError, LookupError, ValueError, TypeError) as error:
        raise InvalidData(f"{path}: {error}. A scene needs bin_width_s, wall_size_m and gt_* of [H, W].") from error
    if not (intensity.ndim == 2 and intensity.shape == depth_m.shape == mask.shape):
        raise InvalidData(
            f"{path}: gt_intensity {intensity.shape}, gt_depth {depth_m.shape} and gt_mask {mask.shape} must be the "
            "same [H, W]."
        )
    if not (np.isfinite(intensity).all() and intensity.max(initial=0) > 0):
        raise InvalidData(f"{path}: gt_intensity holds no light or is not finite; there is nothing to compare with.")
    intensity, depth_m, mask = (places.upright(each) for each in (intensity, depth_m, mask))  # as histograms are
    depth_m = checked_depth(path, depth_m, mask > 0)
    return Scene(path.stem, path, intensity, depth_m, mask > 0, wall, None if falloff is None else int(falloff))


def datasets(scene: Scene) -> list[str]:
    """The names of the scene's histograms."""
    with open_hdf5(scene.path) as file:
        held = {name: find_dataset(file, name) for name in file}
        return [name for name, dataset in held.items() if dataset is not None and dataset.ndim == 3]


def has_condition(scene: Scene, condition: str) -> bool:
    """Whether the scene has the datasets that `condition` names."""
    return parsed(condition).needed <= set(datasets(scene))


def transient_of(scene: Scene, condition: str) -> Transient:
    """The scene's histograms under a condition; points outside it, and those not measured, have exposure 0 and no
    counts. Raises `InvalidData`, also for raw histograms."""
    wanted = parsed(condition)
    scan = read_plain(scene.path, wanted.dataset)
    whole = replace(scan.transient, response=scan.response)
    if whole.exposure_s.shape != scene.intensity.shape:
        raise InvalidData(
            f"{scene.path}: {wanted.dataset} was measured on {whole.wall.rows} x {whole.wall.cols} points, the truth "
            f"is given on {scene.intensity.shape[0]} x {scene.intensity.shape[1]}."
        )
    if not scan.rectified:
        raise InvalidData(
            f"{scene.path}: {wanted.dataset}: is raw, and methods are compared from time 0 at the wall on, without "
            "direct light. Store it so, with rectified = 1."
        )
    check_reach(scene.path, scene.depth_m, whole.time)
    if (whole.counts < 0).any():
        raise InvalidData(f"{scene.path}: {wanted.dataset} holds {int((whole.counts < 0).sum())} counts below 0.")
    if wanted.fwhm_ps is not None:
        whole = slowed(whole, read_plain(scene.path, NOISELESS).transient, wanted.fwhm_ps)
    exposure_s = whole.exposure_s * measured_points(wanted.subset, whole.wall.rows, whole.wall.cols)
    counts = whole.counts * (exposure_s > 0)
    counts[: scan.direct_cut_bins] = 0
    return replace(whole, counts=counts, exposure_s=exposure_s)


def _run(
    scene: Scene, transient: Transient, one: Entrant, settings: dict[str, object], condition: str, device: str
) -> tuple[Row, Reconstruction]:
    if scene.falloff is not None and "falloff" in find(one.method).Settings.model_fields:
        settings = {"falloff": scene.falloff, **settings}
    forget_peak()
    try:
        done = reconstruct(transient, one.method, settings, device)
    except NO_PICTURE as error:
        raise type(error)(f"{scene.name}, {condition}, {one.name}: {error}") from error
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


def _mean_psnr(runs: list[tuple[Row, Reconstruction]]) -> float:
    return float(np.mean([row.psnr for row, _ in runs]))


def as_json(rows: list[Row]) -> list[dict[str, Any]]:
    """The rows as plain values; NaN (no depth at all) becomes null."""
    return [{key: None if value != value else value for key, value in asdict(row).items()} for row in rows]
