"""Trains any learned method of the catalogue: one loop, alone or as one of several processes under torchrun.

Everything random follows from (seed, step), so a run that is killed resumes from its last checkpoint bit for bit.
"""

import math
import signal
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist

from nlos.acquisition.errors import InvalidData as NotAMeasurement
from nlos.recon.errors import InvalidSettings, ReconError
from nlos.recon.training.batches import mirrored_batch, pooled, whole_scan, with_uniform_noise
from nlos.recon.training.curves import Redrawn, draw, last_rate_of
from nlos.recon.training.feed import Feed, workers_for
from nlos.recon.training.file_checks import learned_from
from nlos.recon.training.interruption import Asked, caught
from nlos.recon.training.log import Log
from nlos.recon.training.network import device_here, networks, objective
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
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import validate

Report = Callable[[str], None]
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
    run = _Run(settings, folder, report, place)
    if (ended := ended_run(folder, settings, run.step)) is not None:
        return ended
    run.look_before()
    workers = workers_for(settings, (settings.steps - run.step) * settings.batch, place.world, run.device)
    with Feed(settings, run.part, run.step, workers) as feed:
        done = run.step == settings.steps
        while not done:
            heard = run.learn(run.samples(feed), asked)
            if progress is not None:
                progress(run.step, settings.steps, heard.loss)
            done = heard.told_to_end or heard.out_of_time or run.step == settings.steps
            run.keep_and_look(done)
            if heard.told_to_end:
                return run.broken_off(asked.number or signal.SIGTERM)
    return run.finish(feed.waited_s)


@dataclass(frozen=True)
class _Heard:
    """What a step came to, the mean over all processes; what any of them was told, all do."""

    loss: float
    told_to_end: bool
    out_of_time: bool


class _Run:
    """A run under way: the network, what is kept beside it, and how far it is."""

    def __init__(self, settings: TrainSettings, folder: Path, report: Report, place: Place) -> None:
        self.settings, self.folder, self.report, self.place = settings, folder, report, place
        torch.manual_seed(settings.seed)
        mine, rest = divmod(settings.batch, place.world)
        if rest:
            raise InvalidSettings(f"a batch of {settings.batch} does not divide among {place.world} processes")
        self.part = slice(place.rank * mine, (place.rank + 1) * mine)
        self.device = device_here()
        self.model, self.halved, before = networks(settings, self.device)
        self.parameters = [p for p in self.model.parameters() if p.requires_grad]
        self.optimiser = torch.optim.AdamW(
            self.parameters, lr=settings.learning_rate, betas=(0.9, 0.98), weight_decay=settings.weight_decay
        )
        self.average = [p.detach().clone() for p in self.parameters]
        learned = learned_from(settings)
        self.begun_with = BegunWith(before, learned)
        self.step, self.spent_s = resume_run(settings, folder, self.model, self.optimiser, self.average, learned)
        self.elapsed, self.skipped, self.saving_s = self.spent_s, 0, 0.0
        self.started = self.saved = clock.monotonic()
        self.log = Log(folder / LOG, self.step, self.leads, settings.tensorboard)
        self.curves, self.checks = Redrawn(folder / LOG), validation_steps(settings.steps)
        count = sum(p.numel() for p in self.parameters)
        report(
            f"{settings.method}: {count:,} parameters, from step {self.step} of {settings.steps}"
            + whole_batches(settings)
        )

    @property
    def leads(self) -> bool:
        """Whether this process is the one that writes."""
        return self.place.rank == 0

    def look_before(self) -> None:
        """Says a rate that rises, and what the weights that a run begins with are worth."""
        if rises := rate_rises(self.settings, self.step, last_rate_of(self.folder / LOG)):
            self.report(rises)
        self.started = self.saved = clock.monotonic()
        if self.leads and self.step == 0 and self.settings.start_from is not None:
            figures = self._check()
            self.log.line({"step": 0, "seconds": clock.monotonic() - self.started, "validation": figures})
            self.report(f"before the first step, {self.settings.start_from}: " + _told(figures))

    def samples(self, feed: Feed) -> dict[str, torch.Tensor]:
        """The next batch on the device. Where none can be had, what was learned is kept first."""
        try:
            return {name: x.to(self.device) for name, x in feed.batch().items()}
        except (ReconError, OSError, ValueError, NotAMeasurement):
            self._keep_state()
            raise

    def learn(self, batch: dict[str, torch.Tensor], asked: Asked) -> _Heard:
        """One step. Raises ReconstructionFailed where the loss, or too many gradients in a row, are not finite."""
        settings, world = self.settings, self.place.world
        torch.manual_seed(hash((settings.seed, self.step, self.place.rank)))
        rng = np.random.default_rng((settings.seed, self.step, 12))
        network = self.model
        if settings.uniform_noise_most:
            batch = with_uniform_noise(batch, settings.uniform_noise_least, settings.uniform_noise_most, rng)
        wanted = self.halved is not None and rng.random() < settings.pooled_share
        if self.halved is not None and wanted and everywhere(whole_scan(batch), world, self.device):
            batch, network = pooled(batch), self.halved
        if settings.flips:
            batch = mirrored_batch(batch, rng)
        rate = learning_rate(settings, self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        terms = objective(network, batch, settings, self.device)
        late = settings.max_minutes is not None and clock.monotonic() - self.started >= 60 * settings.max_minutes
        flags = [torch.tensor(float(flag), device=self.device) for flag in (asked.number is not None, late)]
        values = mean_of_all(torch.stack([*(value.detach().float() for value in terms.values()), *flags]), world)
        *means, told_to_end, out_of_time = values.tolist()
        told = dict(zip(terms, means, strict=True))
        if not math.isfinite(told["loss"]):
            raise not_finite(f"the loss is {told['loss']}", self.folder, self.step, settings.steps)
        terms["loss"].backward()  # type: ignore[no-untyped-call]
        norm = step_together(self.parameters, self.optimiser, settings.clip, world)
        self.skipped = 0 if math.isfinite(norm) else self.skipped + 1
        if self.skipped == MOST_SKIPPED:
            why = f"no gradient of {self.skipped} steps was finite"
            raise not_finite(why, self.folder, self.step, settings.steps)
        follow(self.average, self.parameters, self.step, settings.average)
        self.step += 1
        self.elapsed = self.spent_s + clock.monotonic() - self.started
        self.log.terms(self.step, told, rate, norm, self.elapsed, every=max(1, settings.steps // LINES))
        return _Heard(told["loss"], bool(told_to_end), bool(out_of_time))

    def keep_and_look(self, done: bool) -> None:
        """After a step: the state where it is time for it, or all is done; the validation scenes where they are due."""
        now = clock.monotonic()
        if done or now - self.saved > max(60 * self.settings.checkpoint_minutes, SAVING_MOST * self.saving_s):
            self._keep_state()
            self.saved = clock.monotonic()
            self.saving_s = self.saved - now
        if self.leads and not done and self.step in self.checks:
            figures = self._check()
            self.log.line({"step": self.step, "seconds": self.elapsed, "validation": figures})
            self.report(f"step {self.step}/{self.settings.steps}, {self.elapsed / 60:.1f} min: " + _told(figures))
            self.curves.again()

    def broken_off(self, by: int) -> dict[str, Any]:
        """The summary of a run that a signal ended; its state is saved."""
        if self.leads:
            draw(self.folder / LOG)
        return self._so_far() | {"finished": self.step == self.settings.steps, "signal": by}

    def finish(self, waited_s: float) -> dict[str, Any]:
        """The last look at the validation scenes, beside the light-cone transform, and the summary."""
        share = waited_s / max(clock.monotonic() - self.started, 1e-9)
        if share > WAITED_MOST:
            self.report(
                f"the network waited for samples {100 * share:.0f} % of the time: more `workers`, or a cache, may help"
            )
        summary = self._so_far() | {"data_wait": share}
        if self.leads:
            figures = self._check(against_lct=True)
            ended = {"finished": self.step == self.settings.steps, "best": best_of(self.folder)}
            summary |= {"validation": figures} | ended
            self.log.line(summary)
            self.report(f"{summary['minutes']:.1f} min, {summary['samples']} samples: " + _told(figures))
            draw(self.folder / LOG)
        if self.place.world > 1:
            dist.barrier()
        return summary

    def _so_far(self) -> dict[str, Any]:
        return {"step": self.step, "samples": self.step * self.settings.batch, "minutes": self.elapsed / 60}

    def _about(self, figures: Mapping[str, float]) -> dict[str, Any]:
        return about_run(self.settings, self.model, self.step, self.elapsed, dict(figures), self.begun_with)

    def _keep_state(self) -> None:
        if self.leads:
            about = self._about({})
            save_state(self.folder, self.model, self.optimiser, self.average, about)
            if not (self.folder / WEIGHTS).exists():
                save_weights(self.folder, self.model, self.average, about)

    def _check(self, against_lct: bool = False) -> dict[str, float]:
        """The running mean on the validation scenes; kept where it is the best so far."""
        figures: dict[str, float] = with_average(
            self.average, self.parameters, lambda: validate(self.model, self.settings, self.device, against_lct)
        )
        judged = getattr(self.model, "training_loss", None) is None
        keep_best(self.folder, self.model, self.average, self._about(figures), judged=judged)
        return figures


def _silent(line: str) -> None:
    """What a process says whose words another one says."""
    del line


def _told(figures: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3f}" for name, value in figures.items())
