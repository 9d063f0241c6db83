"""Everything that would stop a training, found before its first step: each problem with the key to change."""

import json
import math
import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from pydantic import ValidationError

from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidSettings, ReconError, ReconstructionFailed
from nlos.recon.methods import find, usable
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.file_checks import Problem, problems_of_files
from nlos.recon.training.impulse_responses import read_impulse_response
from nlos.recon.training.memory import out_of_memory_in_words, too_large
from nlos.recon.training.scenes import kind_names, kinds_to_name
from nlos.recon.training.train_settings import GEOMETRY, TrainSettings
from nlos.recon.weights.files import WeightsError, find_weights, load_weights, read_about

TRIED = 3
"""Samples that are made before a training begins: every one of them would be, sooner or later."""


def problems(settings: TrainSettings) -> list[Problem]:
    """What is wrong with a training, the cheapest to find first; empty where it can begin. Nothing is written."""
    found = [*_of_method(settings), *_of_run(settings), *_of_files(settings)]
    for block in ("data", "validation"):
        found += _of_data(getattr(settings, block), block)
    if not found and (why := too_large(settings)) is not None:
        found.append((("data",), why))
    if not found:
        found += problems_of_files(settings)
    if not found:
        found += _of_scenes(settings)
    if not found:
        found += _of_network(settings)
    return found


def trainable() -> list[str]:
    """The methods that have weights."""
    return [name for name in usable() if "weights" in find(name).Settings.model_fields]


def _of_method(settings: TrainSettings) -> Iterator[Problem]:
    try:
        method = find(settings.method)
    except InvalidSettings as error:
        yield ("method",), str(error)
        return
    if "weights" not in method.Settings.model_fields:
        yield ("method",), f"{settings.method} learns nothing; methods that do: {', '.join(trainable())}"
        return
    if settings.method_settings.get("weights") is not None:
        yield ("method_settings", "weights"), "a training begins without weights; name them as `start_from`"
    try:
        method.Settings.model_validate_json(json.dumps({"weights": None} | settings.method_settings))
    except ValidationError as error:
        for one in error.errors():
            known = ", ".join(method.Settings.model_fields)
            what = f"{settings.method} has no such setting; it has: {known}" if one["type"] == "extra_forbidden" else (
                f"{one['msg']} (given {one['input']!r})")  # fmt: skip
            yield ("method_settings", *one["loc"]), what


def _of_run(settings: TrainSettings) -> Iterator[Problem]:
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    if settings.batch % processes:
        yield ("batch",), f"a batch of {settings.batch} does not divide among {processes} processes"
    if settings.last_rate > settings.learning_rate:
        yield ("last_rate",), f"is above learning_rate ({settings.learning_rate:g}); the rate falls from that to this"
    if settings.warm_up_steps >= max(settings.steps, 2):
        steps = "1 step; no more" if settings.steps == 1 else f"{settings.steps} steps; fewer"
        yield ("warm_up_steps",), f"the whole training has {steps} must warm up"
    loss = settings.loss
    if not any((loss.picture, loss.log_picture, loss.depth)):
        yield ("loss",), "picture, log_picture and depth are all 0: nothing would be learned"
    if settings.pooled_share and (settings.data.rows % 2 or settings.data.cols % 2):
        yield ("pooled_share",), f"adds points 2 x 2, which {settings.data.rows} x {settings.data.cols} points are not"
    if settings.tensorboard and find_spec("tensorboard") is None:
        yield ("tensorboard",), "TensorBoard is not installed: pip install 'nlos[tensorboard]', or leave this out"
    if shared := _shared_scenes(settings):
        yield shared
    for key in GEOMETRY:
        mine, other = getattr(settings.validation, key), getattr(settings.data, key)
        if mine != other:
            yield ("validation", key), f"must be that of data, {other} (given {mine}); leave it out, it is inherited"


def _shared_scenes(settings: TrainSettings) -> Problem | None:
    """Validation by made scenes that are learned from: those of one seed, among kinds that both draw."""
    held, learned = settings.validation, settings.data
    if any(data.files is not None and data.share == 1 for data in (held, learned)):
        return None
    if (held.seed, held.held_out) != (learned.seed, learned.held_out):
        return None
    kinds = [set(data.kinds or kind_names(data.held_out)) for data in (held, learned)]
    if not kinds[0] & kinds[1]:
        return None
    return ("validation", "seed"), (
        f"is that of data, {held.seed}, and so are its kinds of scenes: it would judge by scenes that are learned "
        "from. Give another seed, and `held_out: true` for kinds that are never learned from"
    )


def _of_files(settings: TrainSettings) -> Iterator[Problem]:
    for place, name in (
        (("start_from",), settings.start_from),
        (("method_settings", "noise_weights"), settings.method_settings.get("noise_weights")),
    ):
        if isinstance(name, str):
            try:
                method = read_about(find_weights(name)).get("method", settings.method)
            except WeightsError as error:
                yield place, str(error)
                continue
            if place == ("start_from",) and method != settings.method:
                yield place, f"{name} is of the method {method}, this trains {settings.method}"
    cache = settings.cache_path
    if cache is not None:
        existing = next((path for path in (cache, *cache.absolute().parents) if path.exists()), Path("/"))
        if not existing.is_dir() or not os.access(existing, os.W_OK):
            yield ("cache",), f"{existing} is not a writable folder; name another, or null for none"


def _of_data(data: DatasetSettings, block: str) -> Iterator[Problem]:
    known = kinds_to_name(held_out=data.held_out)
    for number, kind in enumerate(data.kinds):
        if kind not in known:
            which = "held out" if data.held_out else "trained on"
            yield (
                (block, "kinds", number),
                f"no such kind among those that are {which}: {', '.join(known)} (given {kind!r})",
            )
    for number, name in enumerate(data.impulse_responses):
        try:
            read_impulse_response(Path(name), data.time.bin_width_s)
        except (OSError, ValueError) as error:
            yield (block, "impulse_responses", number), f"cannot be used: {error}"
    detector = data.detector
    if detector.peak_counts_least > detector.peak_counts_most:
        yield (block, "detector", "peak_counts_least"), f"is above peak_counts_most ({detector.peak_counts_most:g})"
    if detector.noiseless + detector.uniform > 1:
        yield (block, "detector", "noiseless"), "with `uniform` the shares add up to more than 1"


def _of_scenes(settings: TrainSettings) -> Iterator[Problem]:
    """A few samples of each set, made: light that the time axis does not reach, and whatever else stops a sample."""
    for block in ("data", "validation"):
        data = getattr(settings, block)
        for index in range(0, min(len(data), TRIED * data.degradations), data.degradations):
            try:
                sample(data, index)
            except ValueError as error:
                if "time axis" not in str(error):
                    yield (block,), f"sample {index} cannot be made: {error}"
                    break
                window_m = data.time.bins * data.time.bin_width_s * 299792458.0 / 2
                far_m = 1.3 * data.wall_width_m
                needed = math.ceil(2 * far_m / 299792458.0 / data.time.bin_width_s)
                yield (block, "bins"), (
                    f"{data.bins} bins of {data.bin_width_ps:g} ps end {window_m:.2f} m from the wall, and scene "
                    f"{index // data.degradations} lies behind that: about {needed} bins are needed"
                )  # fmt: skip
                break


def _of_network(settings: TrainSettings) -> Iterator[Problem]:
    """The network itself, and the weights that it begins with."""
    from nlos.recon.training.network import build

    wall, time = settings.data.wall, settings.data.time
    try:
        with out_of_memory_in_words(settings):
            model = build(settings, wall, time)
        if settings.pooled_share:
            build(settings, WallGrid(wall.width_m, wall.height_m, wall.rows // 2, wall.cols // 2), time)
    except WeightsError as error:
        yield ("method_settings", "noise_weights"), str(error)
        return
    except ReconstructionFailed as error:
        yield ("data",), str(error)
        return
    except (ReconError, ValueError, RuntimeError, IndexError, ZeroDivisionError, AssertionError) as error:
        grid = f"{wall.rows} x {wall.cols} points, {time.bins} bins"
        yield ("method_settings",), f"{settings.method} cannot be built so for {grid}: {error}"
        return
    if not any(p.requires_grad for p in model.parameters()):
        yield ("method_settings",), f"{settings.method} has nothing to learn with these settings"
    if settings.start_from is not None:
        try:
            load_weights(model, settings.start_from)
        except WeightsError as error:
            yield ("start_from",), str(error)
