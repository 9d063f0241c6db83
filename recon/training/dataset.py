"""Training samples from (seed, index), cached on disk: a scene, its transient, a detector's counts, and the truth.

A share of them may come from scenes on disk (`disk_samples`).

One scene is rendered once and measured `degradations` times. Sample i belongs to scene i // degradations and is the
same whoever asks, in whatever order, cached or not. A cache is a folder of one safetensors file per scene; several
processes may fill it at the same time.
"""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as as_bytes

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.recon.file_mode import readable_as_its_folder
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import measure
from nlos.recon.training.disk_samples import file_number, sample_on_disk
from nlos.recon.training.impulse_responses import UNTOLD, read_impulse_response
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import GENERATOR, Scene, front_view, make_scene, surfels
from nlos.recon.training.second_bounce import render_second_bounce, thinned
from nlos.recon.training.shapes import Array
from nlos.recon.training.training_sample import TRUTH, TrainingSample
from nlos.recon.training.visibility import visibility

BOUNCING = 160


def sample(settings: DatasetSettings, index: int, cache: Path | None = None, device: str = "cpu") -> TrainingSample:
    """Sample `index` (0 .. len(settings) - 1); with a `cache` folder it is read from there, or made and put there.

    On a GPU as `device` light is rendered and photons are drawn there: other photons than on the processor.
    Raises IndexError outside that range.
    """
    if not 0 <= index < len(settings):
        raise IndexError(f"sample {index} of {len(settings)}")
    if settings.files is not None and (number := file_number(index, settings.share)) is not None:
        return sample_on_disk(settings, settings.files, number, cache)
    scene, which = divmod(index, settings.degradations)
    if cache is None:
        return _unpack(*_make(settings, scene, (which,), device), which)
    path = cache_folder(settings, cache) / f"{scene:06d}.safetensors"
    try:
        return _read(path, which)
    except (FileNotFoundError, SafetensorError):
        arrays, words = _make(settings, scene, tuple(range(settings.degradations)))
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.partial")
        with told_of(path, partial):
            partial.write_bytes(as_bytes(arrays, words))
            readable_as_its_folder(partial)
            partial.replace(path)
        return _unpack(arrays, words, which)


def samples_of_scene(settings: DatasetSettings, scene: int, device: str = "cpu") -> list[TrainingSample]:
    """All that `settings` measures of one scene, which is made once."""
    arrays, words = _make(settings, scene, tuple(range(settings.degradations)), device)
    return [_unpack(arrays, words, which) for which in range(settings.degradations)]


def cache_folder(settings: DatasetSettings, cache: Path) -> Path:
    """Where samples of these settings lie in `cache`: the name changes with anything that changes them.

    The number of scenes does not: a longer run uses what a shorter one made. Nor do settings at their defaults, so a
    new one leaves old caches good, nor scenes on disk, which are kept elsewhere.
    """
    left_out = {"scenes", "files", "share"}
    described = settings.model_dump(mode="json", exclude=left_out, exclude_defaults=True) | {"generator": GENERATOR}
    return cache / hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]


def _make(
    settings: DatasetSettings, scene_number: int, wanted: tuple[int, ...], device: str = "cpu"
) -> tuple[dict[str, npt.NDArray[np.generic]], dict[str, str]]:
    scene = make_scene(
        settings.seed, scene_number, settings.wall,
        held_out=settings.held_out, kinds=settings.kinds, solid=settings.solid,
    )  # fmt: skip
    view = front_view(scene, settings.wall)
    rng = np.random.default_rng((settings.seed, scene_number, int(settings.held_out), 1))
    transient = _transient(settings, scene, rng, device)
    responses = [read_impulse_response(Path(name), settings.time.bin_width_s) for name in settings.impulse_responses]
    arrays: dict[str, npt.NDArray[np.generic]] = {name: getattr(view, name) for name in TRUTH}
    arrays["normal"] = view.normal
    words = {"kind": scene.kind}
    for k in wanted:
        draw = np.random.default_rng((settings.seed, scene_number, int(settings.held_out), 2, k))
        got = measure(transient, settings.time, settings.detector, draw, responses, _photons(device, draw))
        small = got.counts.max() <= np.iinfo(np.uint8).max
        arrays[f"counts_{k}"] = got.counts.astype(np.uint8) if small else got.counts
        arrays[f"exposure_{k}"], arrays[f"noise_map_{k}"] = got.exposure, got.noise_map
        arrays[f"response_{k}"] = got.response
        words[f"measured_{k}"] = json.dumps([got.background, got.noise_level, got.condition])
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}, words


def _transient(settings: DatasetSettings, scene: Scene, rng: np.random.Generator, device: str = "cpu") -> Array:
    pieces = surfels(scene, rng)
    seen = visibility(scene, pieces, settings.wall, device) if settings.shadows else None
    transient = render(
        pieces, settings.wall, settings.time, retroreflective=settings.retroreflective, seen=seen, device=device
    ).cpu()
    if settings.second_bounce:
        transient = transient + render_second_bounce(thinned(pieces, BOUNCING, rng), settings.wall, settings.time)
    return np.asarray(transient.numpy(), dtype=np.float32)


def _photons(device: str, rng: np.random.Generator) -> Callable[[Array], Array] | None:
    """What draws photons on `device`; None on the processor, where `measure` draws its own."""
    if device == "cpu":
        return None
    generator = torch.Generator(device).manual_seed(int(rng.integers(2**62)))
    return lambda mean: torch.poisson(torch.from_numpy(mean).to(device), generator).cpu().numpy()


def _unpack(arrays: dict[str, npt.NDArray[np.generic]], words: dict[str, str], which: int) -> TrainingSample:
    background, noise_level, condition = json.loads(words[f"measured_{which}"])
    return TrainingSample(
        counts=arrays[f"counts_{which}"].astype(np.uint16),
        **{name: arrays[f"{name}_{which}"].astype(np.float32) for name in ("exposure", "noise_map")},
        **{name: arrays[name].astype(np.float32) for name in (*TRUTH, "normal")},
        noise_level=noise_level,
        background=background,
        kind=words["kind"],
        condition=condition,
        response=arrays.get(f"response_{which}", UNTOLD).astype(np.float32),
    )


def _read(path: Path, which: int) -> TrainingSample:
    with safe_open(path, framework="numpy") as file:
        names = [*TRUTH, "normal", *(f"{name}_{which}" for name in ("counts", "exposure", "noise_map"))]
        names += {f"response_{which}"} & set(file.keys())  # caches made before responses were told have none
        return _unpack({name: file.get_tensor(name) for name in names}, file.metadata(), which)
