"""A trial of a training: what it takes on this machine, measured by a few steps that are thrown away."""

import time

import torch

from nlos.recon.peak_memory import peak_rss_mb
from nlos.recon.training.batches import batch_at
from nlos.recon.training.schedule import validation_steps
from nlos.recon.training.train import build, device_here, objective
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import validate

STEPS = 2


def trial(settings: TrainSettings, seen: int = 0) -> dict[str, float]:
    """Parameters, peak memory, seconds a sample to make and to learn from, seconds of one validation, hours for the
    samples after those `seen` and the validations between them.

    A cache is neither read nor written; scenes that lie in one cost less than this says. The next batch is made while
    one is learned from, so a sample takes the longer of the two.
    """
    device = device_here()
    model = build(settings, settings.data.wall, settings.data.time).to(device)
    making, learning = [], []
    for step in range(STEPS):
        began = time.perf_counter()
        batch = {name: x.to(device) for name, x in batch_at(settings.data, None, 0, step, settings.batch).items()}
        made = time.perf_counter()
        objective(model, batch, settings, device)["loss"].backward()  # type: ignore[no-untyped-call]
        if device != "cpu":
            torch.cuda.synchronize()
        making.append((made - began) / settings.batch)
        learning.append((time.perf_counter() - made) / settings.batch)
    one = settings.validation.model_copy(update={"scenes": 1, "degradations": 1})
    began = time.perf_counter()
    validate(model, settings.model_copy(update={"validation": one, "cache": None}), device)
    validation_s = (time.perf_counter() - began) * len(settings.validation)
    step = seen // settings.batch
    validations = 1 + sum(at > step for at in validation_steps(settings.steps) - {settings.steps})
    each_s = max(min(making), min(learning))
    return {
        "parameters": sum(p.numel() for p in model.parameters() if p.requires_grad),
        "peak_rss_mb": peak_rss_mb(),
        "seconds_to_make_a_sample": min(making),
        "seconds_to_learn_from_it": min(learning),
        "seconds_per_sample": each_s,
        "seconds_of_validation": validation_s,
        "hours_left": (max(settings.seen - seen, 0) * each_s + validations * validation_s) / 3600,
    }
