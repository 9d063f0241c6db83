"""Training samples from scenes on disk: which of a run's samples they are, and how they are measured."""

import hashlib
import os
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file
from safetensors.numpy import save as as_bytes

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.recon.file_mode import readable_as_its_folder
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import measure
from nlos.recon.training.impulse_responses import read_impulse_response
from nlos.recon.training.on_grid import on_grid
from nlos.recon.training.scenes_on_disk import SceneOnDisk, read_scene, scene_files
from nlos.recon.training.shapes import Array
from nlos.recon.training.training_sample import TrainingSample

DARKEST = 0.5
"""Part of the bins, the emptiest ones, that the background of a measured scan is taken from."""


def file_number(index: int, share: float) -> int | None:
    """Which of the samples from files sample `index` is; None where it is made. They lie evenly among the others."""
    before, with_it = int(index * share), int((index + 1) * share)
    return before if with_it > before else None


def sample_on_disk(settings: DatasetSettings, pattern: str, number: int, cache: Path | None) -> TrainingSample:
    """Sample `number` of those from files: every file in turn, a scene without noise measured afresh each time.

    Raises what reading and measuring raise, with the file's name.
    """
    files = _listed(pattern)
    if not files:
        raise ValueError(f"{pattern}: no such files")
    path = files[number % len(files)]
    try:
        scene = _fitted(settings, path, cache)
        return _as_counted(scene, path) if scene.counted else _measured(settings, scene, path, number)
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


@lru_cache(maxsize=8)
def _listed(pattern: str) -> tuple[Path, ...]:
    """One order for a whole run; files that come later belong to the next."""
    return tuple(scene_files(pattern))


def _measured(settings: DatasetSettings, scene: SceneOnDisk, path: Path, number: int) -> TrainingSample:
    rng = np.random.default_rng((settings.seed, number, int(settings.held_out), 3))
    responses = [read_impulse_response(Path(name), settings.time.bin_width_s) for name in settings.impulse_responses]
    got = measure(scene.light, settings.time, settings.detector, rng, responses)
    return TrainingSample(
        got.counts, got.exposure, got.noise_map, got.noise_level, got.background, **_truth_of(scene), kind=path.name,
        condition=got.condition, response=got.response,
    )  # fmt: skip


def _as_counted(scene: SceneOnDisk, path: Path) -> TrainingSample:
    """A scan as it was measured, its noise by Poisson's law and its background from its emptiest bins."""
    measured = scene.exposure > 0
    exposure = scene.exposure / scene.exposure[measured].mean()
    safe = np.maximum(exposure, 1e-9)
    profile = np.sort((scene.light * measured).sum(axis=(1, 2)) / exposure.sum())
    background = float(profile[: max(1, int(DARKEST * len(profile)))].mean())
    level = max(float((scene.light.max(axis=0) / safe)[measured].mean()) - background, 1e-6)
    noise = np.sqrt(np.maximum(scene.light.mean(axis=0), 1e-6)) / (safe * level)
    noise_map = np.where(measured, noise, np.inf).astype(np.float32)
    return TrainingSample(
        scene.light * measured, exposure.astype(np.float32), noise_map,
        float(np.sqrt(np.mean(noise_map[measured] ** 2))), background, **_truth_of(scene), kind=path.name,
        condition="as measured",
    )  # fmt: skip


def _truth_of(scene: SceneOnDisk) -> dict[str, Array]:
    """The picture in units of its maximum, as a scene of albedo 1 has it."""
    top = float(scene.intensity.max())
    return {
        "intensity": scene.intensity / top, "albedo": scene.albedo / max(float(scene.albedo.max()), 1e-12),
        "depth_m": scene.depth_m, "coverage": scene.coverage,
        "normal": np.zeros((3, *scene.intensity.shape), np.float32),
    }  # fmt: skip


def _fitted(settings: DatasetSettings, path: Path, cache: Path | None) -> SceneOnDisk:
    """The scene on the training's grid, kept in `cache` where there is one: LFE's take seconds to read."""
    wall, time = settings.wall, settings.time
    if cache is None:
        return on_grid(read_scene(path), wall, time)
    state = path.stat()
    words = repr((str(path.resolve()), state.st_size, state.st_mtime_ns, wall, time))
    kept = cache / "files" / f"{hashlib.sha256(words.encode()).hexdigest()[:24]}.safetensors"
    try:
        held = load_file(kept)
        counted, retroreflective = (bool(held.pop(name)[0]) for name in ("counted", "retroreflective"))
        return SceneOnDisk(**held, wall=wall, time=time, counted=counted, retroreflective=retroreflective)
    except (FileNotFoundError, SafetensorError):
        scene = on_grid(read_scene(path), wall, time)
    arrays = {
        field.name: np.ascontiguousarray(value)
        for field in fields(scene)
        if isinstance(value := getattr(scene, field.name), np.ndarray)
    }
    flags = {name: np.array([getattr(scene, name)], np.uint8) for name in ("counted", "retroreflective")}
    kept.parent.mkdir(parents=True, exist_ok=True)
    partial = kept.with_suffix(f".{os.getpid()}.partial")
    with told_of(kept, partial):
        partial.write_bytes(as_bytes(arrays | flags))
        readable_as_its_folder(partial)
        partial.replace(kept)
    return scene
