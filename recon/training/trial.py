"""A trial of a training: what it takes on this machine, measured by a few steps that are thrown away."""

import time

import torch

from nlos.recon.memory import GIB, available_bytes
from nlos.recon.peak_memory import forget_peak, peak_rss_mb
from nlos.recon.training.batches import batch_at
from nlos.recon.training.network import build, device_here, objective
from nlos.recon.training.schedule import validation_steps
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import validate

MOST_TRIED = 16
"""Samples of a batch: what larger ones take follows from this many."""
EARLY = 2.0
"""What small batches say is up to this many times too much."""
MB = 1 << 20


def tried(batch: int) -> list[int]:
    """The sizes of batches that are tried before one of `batch`, and that one twice unless it is too large to try."""
    last = min(batch, MOST_TRIED)
    return [size for size in (1, 4, 8) if size < last] + [last, last]


def _more_mb(peaks_mb: dict[int, float], batch: int) -> float:
    """What a batch takes beyond the largest tried, as the last two grew; NaN where the system does not tell."""
    if len(peaks_mb) < 2 or batch in peaks_mb:
        return 0.0
    (small, less), (large, more) = list(peaks_mb.items())[-2:]
    return (more - less) / (large - small) * (batch - large)


def trial(settings: TrainSettings, seen: int = 0) -> dict[str, float]:
    """Parameters, peak memory, seconds a sample to make and to learn from, seconds of one validation, hours for the
    samples after those `seen` and the validations between them. Batches grow to the one wanted, and no further than is
    safe: raises `MemoryError` where the next, or the one wanted, would not fit.

    A cache is neither read nor written; scenes that lie in one cost less than this says. The next batch is made while
    one is learned from, so a sample takes the longer of the two.
    """
    device = device_here()
    model = build(settings, settings.data.wall, settings.data.time).to(device)
    making, learning = [], []
    forget_peak()
    peaks_mb: dict[int, float] = {}
    sizes = tried(settings.batch)
    for step, size in enumerate(sizes):
        began = time.perf_counter()
        batch = {name: x.to(device) for name, x in batch_at(settings.data, None, 0, step, size).items()}
        made = time.perf_counter()
        objective(model, batch, settings, device)["loss"].backward()  # type: ignore[no-untyped-call]
        if device != "cpu":
            torch.cuda.synchronize()
        making.append((made - began) / size)
        learning.append((time.perf_counter() - made) / size)
        peaks_mb[size] = peak_rss_mb()
        more_mb = _more_mb(peaks_mb, settings.batch)
        if device == "cpu" and more_mb * MB > available_bytes() * (1 if size == sizes[-1] else EARLY):
            raise MemoryError(
                f"going by batches of up to {size}, one of {settings.batch} takes about {more_mb / 1024:.1f} GiB more, "
                f"{available_bytes() / GIB:.1f} GiB are free"
            )
    one = settings.validation.model_copy(update={"scenes": 1, "degradations": 1})
    began = time.perf_counter()
    validate(model, settings.model_copy(update={"validation": one, "cache": None}), device)
    validation_s = (time.perf_counter() - began) * len(settings.validation)
    step = seen // settings.batch
    validations = 1 + sum(at > step for at in validation_steps(settings.steps) - {settings.steps})
    each_s = max(min(making), min(learning))
    return {
        "parameters": sum(p.numel() for p in model.parameters() if p.requires_grad),
        "peak_rss_mb": peak_rss_mb() + _more_mb(peaks_mb, settings.batch),
        "seconds_to_make_a_sample": min(making),
        "seconds_to_learn_from_it": min(learning),
        "seconds_per_sample": each_s,
        "seconds_of_validation": validation_s,
        "hours_left": (max(settings.seen - seen, 0) * each_s + validations * validation_s) / 3600,
    }
