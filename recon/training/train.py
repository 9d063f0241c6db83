"""Trains any learned method of the catalogue: one loop, alone or as one of several processes under torchrun.

The network is `recon.methods.<method>.build(settings, wall, time)`; called with counts (B, 1, T, H, W) and relative
exposure (B, H, W) it returns (albedo (B, H, W), depth in metres (B, H, W), volume or None), the albedo in units of the
picture's maximum. It may instead bring its own objective, `training_loss(batch) -> {"loss": ..., ...}`, batch as
`dataset.collate` makes it. Its Settings have a field `weights`, which is None here: training begins afresh.

Everything random follows from (seed, step), so a run that is killed resumes from its last checkpoint bit for bit.
"""

import math
import os
import signal
import time as clock
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import nn

from nlos.acquisition.errors import InvalidData as NotAMeasurement
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidSettings, ReconError
from nlos.recon.methods import find
from nlos.recon.training.architecture import method_settings
from nlos.recon.training.batches import mirrored_batch, pooled, whole_scan, with_uniform_noise
from nlos.recon.training.checkpoint import share_parameters
from nlos.recon.training.curves import Redrawn, draw, last_rate_of
from nlos.recon.training.feed import Feed, workers_for
from nlos.recon.training.file_checks import learned_from
from nlos.recon.training.interruption import Asked, caught
from nlos.recon.training.log import Log
from nlos.recon.training.losses import losses
from nlos.recon.training.ranks import Place, everywhere, join, mean_of_all, step_together
from nlos.recon.training.run_folder import (
    LOG,
    STATE,
    WEIGHTS,
    BegunWith,
    about_run,
    alone_in,
    best_of,
    ended_run,
    keep_best,
    not_finite,
    resume_run,
    save_state,
    save_weights,
)
from nlos.recon.training.running_mean import follow, with_average
from nlos.recon.training.schedule import learning_rate, rate_rises, validation_steps, whole_batches
from nlos.recon.training.shallow_convolutions import ShallowInFloat32
from nlos.recon.training.told import told
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import validate
from nlos.recon.weights.files import load_weights

Report = Callable[[str], None]
Objective = Callable[[Mapping[str, torch.Tensor]], dict[str, torch.Tensor]]
Progress = Callable[[int, int, float], None]
LINES = 400
SAVING_MOST = 20
"""Times what saving a state takes: states are not saved more often."""
WAITED_MOST = 0.05
"""Of the time, for samples: above it, the user hears of it."""
MOST_SKIPPED = 25
"""So many gradients in a row that are not finite: nothing is learned any more."""


def train(
    settings: TrainSettings,
    folder: Path,
    report: Report = print,
    *,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Train into `folder`, resuming what is there unless `overwrite`; returns the summary at the end of its log.

    Files: log.jsonl and log.csv, state.safetensors (last, to resume), weights.safetensors (running mean, the best on
    the validation scenes, to use), loss.png. `progress` is told every step: how many, of how many, and the loss.
    SIGINT and SIGTERM end it after the step under way, its state saved; the summary then says `signal`.

    Raises InvalidSettings if `folder` holds a run of other settings or another process trains there, WeightsError for
    weights that do not fit, ReconstructionFailed for a loss that is not finite.
    """
    place = join()
    if place.rank:
        report, progress = _silent, None
    try:
        with alone_in(folder, place.rank), caught() as asked:
            if overwrite and place.rank == 0:
                for name in (STATE, WEIGHTS, LOG):
                    (folder / name).unlink(missing_ok=True)
            if place.world > 1:
                dist.barrier()
            return _train(settings, folder, report, progress, asked, place)
    finally:
        if place.world > 1:
            dist.destroy_process_group()


def _train(
    settings: TrainSettings, folder: Path, report: Report, progress: Progress | None, asked: Asked, place: Place
) -> dict[str, Any]:
    rank, world = place.rank, place.world
    torch.manual_seed(settings.seed)
    if settings.batch % world:
        raise InvalidSettings(f"a batch of {settings.batch} does not divide among {world} processes")
    part = slice(rank * (settings.batch // world), (rank + 1) * (settings.batch // world))
    device = device_here()
    model, halved, before = _networks(settings, device)
    parameters = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(
        parameters, lr=settings.learning_rate, betas=(0.9, 0.98), weight_decay=settings.weight_decay
    )
    average = [p.detach().clone() for p in parameters]
    learned = learned_from(settings)
    begun_with = BegunWith(before, learned)
    step, spent_s = resume_run(settings, folder, model, optimiser, average, learned)
    log = Log(folder / LOG, step, rank == 0, settings.tensorboard)
    count = sum(p.numel() for p in parameters)
    report(f"{settings.method}: {count:,} parameters, from step {step} of {settings.steps}" + whole_batches(settings))
    if (ended := ended_run(folder, settings, step)) is not None:
        return ended
    if rises := rate_rises(settings, step, last_rate_of(folder / LOG)):
        report(rises)
    started = saved = clock.monotonic()
    saving_s = 0.0
    elapsed, late, skipped = spent_s, False, 0
    checks, curves = validation_steps(settings.steps), Redrawn(folder / LOG)

    def keep_state() -> None:
        if rank == 0:
            about = about_run(settings, model, step, elapsed, {}, begun_with)
            save_state(folder, model, optimiser, average, about)
            if not (folder / WEIGHTS).exists():
                save_weights(folder, model, average, about)

    def check(against_lct: bool = False) -> dict[str, float]:
        figures: dict[str, float] = with_average(
            average, parameters, lambda: validate(model, settings, device, against_lct)
        )
        about = about_run(settings, model, step, elapsed, figures, begun_with)
        keep_best(folder, model, average, about, judged=getattr(model, "training_loss", None) is None)
        return figures

    if rank == 0 and step == 0 and settings.start_from is not None:
        figures = check()
        log.line({"step": 0, "seconds": clock.monotonic() - started, "validation": figures})
        report(f"before the first step, {settings.start_from}: " + _told(figures))
    workers = workers_for(settings, (settings.steps - step) * settings.batch, world, device)
    with Feed(settings, part, step, workers) as feed:
        while step < settings.steps and not late:
            try:
                batch = {name: x.to(device) for name, x in feed.batch().items()}
            except (ReconError, OSError, ValueError, NotAMeasurement):
                keep_state()
                raise
            torch.manual_seed(hash((settings.seed, step, rank)))
            rng = np.random.default_rng((settings.seed, step, 12))
            network = model
            if settings.uniform_noise_most:
                batch = with_uniform_noise(batch, settings.uniform_noise_least, settings.uniform_noise_most, rng)
            wanted = halved is not None and rng.random() < settings.pooled_share
            if halved is not None and wanted and everywhere(whole_scan(batch), world, device):
                batch, network = pooled(batch), halved
            if settings.flips:
                batch = mirrored_batch(batch, rng)
            rate = learning_rate(settings, step)
            for group in optimiser.param_groups:
                group["lr"] = rate
            terms = objective(network, batch, settings, device)
            late = settings.max_minutes is not None and clock.monotonic() - started >= 60 * settings.max_minutes
            flags = [torch.tensor(float(flag), device=device) for flag in (asked.number is not None, late)]
            values = mean_of_all(torch.stack([*(value.detach().float() for value in terms.values()), *flags]), world)
            *heard, told_to_end, out_of_time = values.tolist()
            told = dict(zip(terms, heard, strict=True))
            if not math.isfinite(told["loss"]):
                raise not_finite(f"the loss is {told['loss']}", folder, step, settings.steps)
            terms["loss"].backward()  # type: ignore[no-untyped-call]
            norm = step_together(parameters, optimiser, settings.clip, world)
            skipped = 0 if math.isfinite(norm) else skipped + 1
            if skipped == MOST_SKIPPED:
                raise not_finite(f"no gradient of {skipped} steps was finite", folder, step, settings.steps)
            follow(average, parameters, step, settings.average)
            step += 1
            now = clock.monotonic()
            elapsed = spent_s + now - started
            log.terms(step, told, rate, norm, elapsed, every=max(1, settings.steps // LINES))
            if progress is not None:
                progress(step, settings.steps, told["loss"])
            late = bool(told_to_end or out_of_time)  # what any process heard, all do
            done = late or step == settings.steps
            if done or now - saved > max(60 * settings.checkpoint_minutes, SAVING_MOST * saving_s):
                keep_state()
                saved = clock.monotonic()
                saving_s = saved - now
            if rank == 0 and not done and step in checks:
                figures = check()
                log.line({"step": step, "seconds": elapsed, "validation": figures})
                report(f"step {step}/{settings.steps}, {elapsed / 60:.1f} min: " + _told(figures))
                curves.again()
            if told_to_end:
                if rank == 0:
                    draw(folder / LOG)
                return {
                    "step": step, "samples": step * settings.batch, "minutes": elapsed / 60,
                    "finished": step == settings.steps, "signal": asked.number or signal.SIGTERM,
                }  # fmt: skip
    share = feed.waited_s / max(clock.monotonic() - started, 1e-9)
    if share > WAITED_MOST:
        report(f"the network waited for samples {100 * share:.0f} % of the time: more `workers`, or a cache, may help")
    summary: dict[str, Any] = {"step": step, "samples": step * settings.batch, "minutes": elapsed / 60}
    summary["data_wait"] = share
    if rank == 0:
        figures = check(against_lct=True)
        summary |= {"validation": figures, "finished": step == settings.steps, "best": best_of(folder)}
        log.line(summary)
        report(f"{summary['minutes']:.1f} min, {summary['samples']} samples: " + _told(figures))
        draw(folder / LOG)
    if world > 1:
        dist.barrier()
    return summary


def _silent(line: str) -> None:
    """What a process says whose words another one says."""
    del line


def _networks(settings: TrainSettings, device: str) -> tuple[nn.Module, nn.Module | None, dict[str, Any]]:
    """The network for the grid of the data, the same parameters on half that grid if steps are to see it, and what
    was said about the weights that it begins with."""
    wall, time = settings.data.wall, settings.data.time
    model = build(settings, wall, time).to(device)
    before = load_weights(model, settings.start_from) if settings.start_from else {}
    if not settings.pooled_share:
        return model, None, before
    half = WallGrid(wall.width_m, wall.height_m, wall.rows // 2, wall.cols // 2)
    return model, share_parameters(model, build(settings, half, time).to(device)), before


def device_here() -> str:
    """Where this process computes: a GPU where PyTorch sees one."""
    return f"cuda:{os.environ.get('LOCAL_RANK', 0)}" if torch.cuda.is_available() else "cpu"


def half_precision(settings: TrainSettings, device: str) -> bool:
    """Whether to compute in bfloat16: where the processor has it, unless told otherwise."""
    if settings.precision != "auto":
        return settings.precision == "bf16"
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def build(settings: TrainSettings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """The method's network without weights, laid out for the processor's fastest convolutions."""
    model = find(settings.method).build(method_settings(settings), wall, time)
    model.train()
    for dims, layout in ((5, torch.channels_last_3d), (4, torch.channels_last)):
        for parameter in model.parameters():
            if parameter.ndim == dims:
                parameter.data = parameter.data.contiguous(memory_format=layout)
    return model


def objective(
    network: nn.Module, batch: Mapping[str, torch.Tensor], settings: TrainSettings, device: str
) -> dict[str, torch.Tensor]:
    """The terms of the loss and their sum, `loss`, computed in the precision of the settings."""
    kind = torch.device(device).type
    shallow = ShallowInFloat32() if kind == "cpu" else nullcontext()
    with torch.autocast(kind, torch.bfloat16, enabled=half_precision(settings, kind)), shallow:
        own: Objective | None = getattr(network, "training_loss", None)
        if own is not None:
            return own(batch)
        prediction = network(batch["counts"], batch["exposure"], *told(network, batch))
    return losses(prediction, batch, settings.loss)


def _told(figures: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3f}" for name, value in figures.items())
