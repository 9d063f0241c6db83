"""Trains any learned method of the catalogue: one loop, alone or as one of several processes under torchrun.

The network is `recon.methods.<method>.build(settings, wall, time)`; called with counts (B, 1, T, H, W) and relative
exposure (B, H, W) it returns (albedo (B, H, W), depth in metres (B, H, W), volume or None), the albedo in units of the
picture's maximum. It may instead bring its own objective, `training_loss(batch) -> {"loss": ..., ...}`, batch as
`dataset.collate` makes it. Its Settings have a field `weights`, which is None here: training begins afresh.

Everything random follows from (seed, step), so a run that is killed goes on from its last checkpoint bit for bit.
"""

import json
import math
import os
import time as clock
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find
from nlos.recon.training.batches import batch_at, mirrored_batch, pooled, whole_scan, with_uniform_noise
from nlos.recon.training.checkpoint import share_parameters
from nlos.recon.training.log import Log, plot
from nlos.recon.training.losses import losses
from nlos.recon.training.run_folder import LOG, about_run, resume_run, save_state, save_weights
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import validate
from nlos.recon.weights.files import load_weights

Report = Callable[[str], None]
Objective = Callable[[Mapping[str, torch.Tensor]], dict[str, torch.Tensor]]
LINES = 400
VALIDATIONS = 5


def train(settings: TrainSettings, folder: Path, report: Report = print) -> dict[str, Any]:
    """Train into `folder`, going on from what is there; returns the summary written to the end of its log.

    Files: log.jsonl, state.safetensors (to go on), weights.safetensors (running mean, to use), loss.png.
    Raises ValueError if `folder` holds a run of other settings, WeightsError for weights that do not fit.
    """
    torch.manual_seed(settings.seed)
    alone = "RANK" not in os.environ
    rank, world = (0, 1) if alone else _join()
    if settings.batch % world:
        raise ValueError(f"a batch of {settings.batch} does not divide among {world} processes")
    part = slice(rank * (settings.batch // world), (rank + 1) * (settings.batch // world))
    device = device_here()
    model, halved, before = _networks(settings, device)
    parameters = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(
        parameters, lr=settings.learning_rate, betas=(0.9, 0.98), weight_decay=settings.weight_decay
    )
    average = [p.detach().clone() for p in parameters]
    step, spent_s = resume_run(settings, folder, model, optimiser, average)
    log = Log(folder / LOG, step, rank == 0, settings.tensorboard)
    count = sum(p.numel() for p in parameters)
    report(f"{settings.method}: {count:,} parameters, from step {step} of {settings.steps}")
    started = saved = clock.monotonic()
    elapsed, late = spent_s, False
    figures: dict[str, float] = {}

    def load(at: int) -> dict[str, torch.Tensor]:
        return batch_at(settings.data, settings.cache_path, settings.seed, at, settings.batch, part)

    with ThreadPoolExecutor(1) as loader:
        ahead = loader.submit(load, step)
        while step < settings.steps and not late:
            batch = {name: x.to(device) for name, x in ahead.result().items()}
            ahead = loader.submit(load, min(step + 1, settings.steps - 1))
            torch.manual_seed(hash((settings.seed, step, rank)))
            rng = np.random.default_rng((settings.seed, step, 12))
            network = model
            if settings.uniform_noise_most:
                batch = with_uniform_noise(batch, settings.uniform_noise_most, rng)
            wanted = halved is not None and rng.random() < settings.pooled_share
            if halved is not None and wanted and _everywhere(whole_scan(batch), world, device):
                batch, network = pooled(batch), halved
            if settings.flips:
                batch = mirrored_batch(batch, rng)
            rate = learning_rate(settings, step)
            for group in optimiser.param_groups:
                group["lr"] = rate
            terms = objective(network, batch, settings, device)
            terms["loss"].backward()  # type: ignore[no-untyped-call]
            norm = _step(parameters, optimiser, settings.clip, world)
            keep = min(settings.average, (1 + step) / (10 + step))
            torch._foreach_lerp_(average, [p.detach() for p in parameters], 1 - keep)
            step += 1
            values = _mean(torch.stack([value.detach().float() for value in terms.values()]), world)
            now = clock.monotonic()
            elapsed = spent_s + now - started
            told = dict(zip(terms, values.tolist(), strict=True))
            log.terms(step, told, rate, norm, elapsed, every=max(1, settings.steps // LINES))
            if settings.max_minutes is not None:
                late = not _everywhere(now - started < 60 * settings.max_minutes, world, device)
            done = late or step == settings.steps
            if rank == 0 and (done or now - saved > 60 * settings.checkpoint_minutes):
                about = about_run(settings, model, step, elapsed, before, figures)
                save_state(folder, model, optimiser, average, about)
                save_weights(folder, model, average, about)
                saved = now
            if rank == 0 and not done and step % max(1, settings.steps // VALIDATIONS) == 0:
                figures = _with(average, parameters, lambda: validate(model, settings, device))
                log.line({"step": step, "seconds": elapsed, "validation": figures})
                report(f"step {step}/{settings.steps}, {elapsed / 60:.1f} min: " + _told(figures))
    summary: dict[str, Any] = {"step": step, "samples": step * settings.batch, "minutes": elapsed / 60}
    if rank == 0:
        figures = _with(average, parameters, lambda: validate(model, settings, device, against_lct=True))
        save_weights(folder, model, average, about_run(settings, model, step, elapsed, before, figures))
        summary |= {"validation": figures, "finished": step == settings.steps}
        log.line(summary)
        report(f"{summary['minutes']:.1f} min, {summary['samples']} samples: " + _told(figures))
        plot(folder / LOG)
    if not alone:
        dist.barrier()
        dist.destroy_process_group()
    return summary


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


def build(settings: TrainSettings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """The method's network without weights, laid out for the processor's fastest convolutions."""
    method = find(settings.method)
    given = json.dumps({"weights": None} | settings.method_settings)
    model = method.build(method.Settings.model_validate_json(given), wall, time)
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
    with torch.autocast(kind, torch.bfloat16, enabled=half_precision(settings, kind)):
        own: Objective | None = getattr(network, "training_loss", None)
        if own is not None:
            return own(batch)
        prediction = network(batch["counts"], batch["exposure"])
    return losses(prediction, batch, settings.loss)


def half_precision(settings: TrainSettings, device: str) -> bool:
    """Whether to compute in bfloat16: where the processor has it, unless told otherwise."""
    if settings.precision != "auto":
        return settings.precision == "bf16"
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def learning_rate(settings: TrainSettings, step: int) -> float:
    """Linear warm-up, then half a cosine or a steady decay."""
    if step < settings.warm_up_steps:
        return settings.learning_rate * (step + 1) / settings.warm_up_steps
    done = (step - settings.warm_up_steps) / max(1, settings.steps - settings.warm_up_steps)
    if settings.schedule == "exponential":
        return float(settings.learning_rate * (settings.last_rate / settings.learning_rate) ** done)
    return settings.last_rate + (settings.learning_rate - settings.last_rate) * (1 + math.cos(math.pi * done)) / 2


def _join() -> tuple[int, int]:
    dist.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    if torch.cuda.is_available():
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    return dist.get_rank(), dist.get_world_size()


def _everywhere(here: bool, world: int, device: str) -> bool:
    """Whether it is so in every process."""
    answer = torch.tensor(float(here), device=device)
    return bool(_mean(answer, world) == 1)


def _mean(x: torch.Tensor, world: int) -> torch.Tensor:
    """The mean over all processes."""
    if world > 1:
        dist.all_reduce(x)
        x /= world
    return x


def _step(parameters: list[nn.Parameter], optimiser: torch.optim.Optimizer, clip: float, world: int) -> float:
    """Average the gradients of all processes, clip, step; a step that is not finite is skipped. Returns the norm."""
    if world > 1:
        flat = torch.cat([(p.grad if p.grad is not None else torch.zeros_like(p)).flatten() for p in parameters])
        _mean(flat, world)
        start = 0
        for p in parameters:
            p.grad = torch.empty_like(p).copy_(flat[start : start + p.numel()].view(p.shape))
            start += p.numel()
    norm = float(nn.utils.clip_grad_norm_(parameters, clip))
    if math.isfinite(norm):
        optimiser.step()
    optimiser.zero_grad(set_to_none=True)
    return norm


def _with(average: list[torch.Tensor], parameters: Sequence[torch.Tensor], do: Callable[[], Any]) -> Any:
    """Do something with the running mean in place of the weights."""
    own = [p.detach().clone() for p in parameters]
    with torch.no_grad():
        torch._foreach_copy_(list(parameters), average)
    try:
        return do()
    finally:
        with torch.no_grad():
            torch._foreach_copy_(list(parameters), own)


def _told(figures: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3f}" for name, value in figures.items())
