"""Trains NANO's operator on a GPU for minutes: `python -m nlos.recon.training.on_gpu FILE FOLDER --minutes 9`.

What `nlos train` does, arranged for a machine that is had for minutes: scans are made and prepared by a process on
every core (`prepared_feed.py`), a step is one graph that the GPU goes through without the processor, and the rate falls
with the time that is left. FILE is a training file of NANO; `samples` and `max_minutes` in it do not count here.
"""

import argparse
import json
import math
import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

import torch
import yaml
from torch import Tensor, nn

from nlos.recon.method import MethodResult
from nlos.recon.methods.nano import CONDITIONS, Nano
from nlos.recon.training.checkpoint import share_parameters
from nlos.recon.training.kept_scans import KeptScans
from nlos.recon.training.losses import losses
from nlos.recon.training.network import build, half_precision
from nlos.recon.training.prepared_feed import PreparedFeed, Recipe, Size, batch_of
from nlos.recon.training.run_folder import BegunWith, about_run, save_weights
from nlos.recon.training.running_mean import follow, with_average
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.validation import made_on, validate
from nlos.recon.weights.files import load_weights

WARM_UPS = 3
"""Steps of a size before its graph is taken, in which libraries choose their ways; their rate is 0."""
IN_FLIGHT = 3
LOGGED_EVERY_S = 10.0


class Steps:
    """Steps down the gradient, one size of scan at a time; the parameters are the same for all."""

    def __init__(self, settings: TrainSettings, device: str) -> None:
        self.settings, self.device, self.batch = settings, device, settings.batch
        self.networks: dict[int, Nano] = {}
        self.model = self._network(settings.data.rows)
        self.before = load_weights(self.model, settings.start_from) if settings.start_from else {}
        self.networks[settings.data.rows] = self.model
        self.parameters = [p for p in self.model.parameters() if p.requires_grad]
        self.average = [p.detach().clone() for p in self.parameters]
        self.rate = torch.zeros((), device=device)
        on_gpu = device != "cpu"
        self.optimiser = torch.optim.AdamW(
            self.parameters, lr=self.rate, betas=(0.9, 0.98), weight_decay=settings.weight_decay, capturable=on_gpu
        )
        self.lost = torch.zeros(4, device=device)
        """Sums since they were read: loss, log_picture, depth, norm of the gradient."""
        self.taken = 0
        self._inputs: dict[Size, tuple[Tensor, Tensor]] = {}
        self._graphs: dict[Size, Any] = {}
        self._warm: dict[Size, int] = {}

    def _network(self, points: int) -> Nano:
        data = self.settings.data.model_copy(update={"rows": points, "cols": points})
        made = build(self.settings, data.wall, data.time).to(self.device)
        assert isinstance(made, Nano)
        return made

    def inputs(self, size: Size) -> tuple[Tensor, Tensor]:
        """Where a batch of this size is to be put: volumes in half precision (B, n), and the rest (B, n)."""
        if size not in self._inputs:
            volumes = torch.zeros(self.batch, size.volumes, dtype=torch.float16, device=self.device)
            others = torch.zeros(self.batch, size.others, device=self.device)
            self._inputs[size] = (volumes, others)
            if size.points not in self.networks:
                self.networks[size.points] = cast(Nano, share_parameters(self.model, self._network(size.points)))
        return self._inputs[size]

    def take(self, size: Size, rate: float) -> None:
        """A step by what lies in the inputs of this size."""
        graph = self._graphs.get(size)
        self.rate.fill_(rate if graph is not None or self.device == "cpu" else 0.0)
        if graph is not None:
            graph.replay()
        elif self.device == "cpu":
            self._step(size)
        elif self._warm.get(size, 0) < WARM_UPS:
            self._warm[size] = self._warm.get(size, 0) + 1
            beside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            beside.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(beside):
                self._step(size)
            torch.cuda.current_stream().wait_stream(beside)
            return
        else:
            torch.cuda.synchronize()
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                self._step(size)
            self._graphs[size] = graph
            return
        follow(self.average, self.parameters, self.taken, self.settings.average)
        self.taken += 1

    def _step(self, size: Size) -> None:
        network, batch = self.networks[size.points], batch_of(*self.inputs(size), size)
        scalars = batch["scalars"]
        self.optimiser.zero_grad(set_to_none=True)
        kind = torch.device(self.device).type
        with torch.autocast(kind, torch.bfloat16, enabled=half_precision(self.settings, kind), cache_enabled=False):
            seen = network.iterate(batch["volumes"].float(), scalars[:, : CONDITIONS + 1], batch["maps"], None)
        albedo, depth_m = seen.albedo * scalars[:, -1, None, None], seen.depth * network.physics.unit_m
        terms = losses(MethodResult(albedo, depth_m, None), batch, self.settings.loss)
        terms["loss"].backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.parameters, self.settings.clip, foreach=True)
        finite = torch.isfinite(norm)
        for p in self.parameters:
            if p.grad is not None:
                p.grad = torch.where(finite, p.grad, 0.0)
        self.optimiser.step()
        with torch.no_grad():
            told_now = [terms[name].detach() for name in ("loss", "log_picture", "depth") if name in terms]
            told_now += [norm.detach()] * (4 - len(told_now))
            self.lost += torch.stack(told_now).nan_to_num(0.0, 0.0, 0.0)


def rate_at(settings: TrainSettings, over: float) -> float:
    """The learning rate after the share `over` of the time: up along a straight line in a fiftieth of it, then down
    along half a cosine."""
    rise = min(1.0, 50 * over)
    fall = settings.last_rate + (settings.learning_rate - settings.last_rate) * (1 + math.cos(math.pi * over)) / 2
    return rise * fall


class Log:
    """log.jsonl of a training, on the terminal as well: what it does with its time, and how good it is."""

    def __init__(self, file: TextIO, steps: Steps, kept: KeptScans) -> None:
        self.file, self.steps, self.kept = file, steps, kept
        self.since, self.waited_s, self.before = time.monotonic(), 0.0, (0, 0)

    def say(self, **words: Any) -> None:
        """One line, numbers to five places."""
        line = json.dumps({name: round(x, 5) if isinstance(x, float) else x for name, x in words.items()})
        print(line, flush=True)
        print(line, file=self.file, flush=True)

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """What takes place in here is waiting for scans."""
        since = time.monotonic()
        yield
        self.waited_s += time.monotonic() - since

    def say_at_times(self, now: float, began: float, rate: float) -> None:
        """The losses and the pace since the last such line, every LOGGED_EVERY_S."""
        passed = now - self.since
        if passed <= LOGGED_EVERY_S:
            return
        steps, arrived = self.steps.taken - self.before[0], self.kept.arrived
        loss, picture, depth, _ = (self.steps.lost / max(1, steps)).tolist()
        self.steps.lost.zero_()
        self.say(
            step=self.steps.taken, scans=arrived, seconds=now - began, loss=loss, picture=picture, depth=depth,
            rate=rate, waited=self.waited_s / passed, learned_a_second=steps * self.steps.batch / passed,
            made_a_second=(arrived - self.before[1]) / passed,
        )  # fmt: skip
        self.since, self.waited_s, self.before = now, 0.0, (self.steps.taken, arrived)


class InFlight:
    """Steps that a GPU was given and may not have taken yet: no more than IN_FLIGHT of them."""

    def __init__(self) -> None:
        self.events: deque[Any] = deque()

    def another(self) -> None:
        """A step was given to the GPU; returns once few enough are left."""
        self.events.append(torch.cuda.Event())  # type: ignore[no-untyped-call]
        self.events[-1].record()
        if len(self.events) > IN_FLIGHT:
            self.events.popleft().synchronize()


def pin(rings: Sequence[Sequence[Tensor]]) -> None:
    """Memory that scans are handed over in, for a GPU to fetch them from by itself."""
    for part in (part for ring in rings for part in ring):
        torch.cuda.cudart().cudaHostRegister(part.data_ptr(), part.numel() * part.element_size(), 0)  # type: ignore[no-untyped-call]


def train_for(settings: TrainSettings, folder: Path, asked: argparse.Namespace) -> None:
    """Train into `folder`: weights.safetensors, the running mean, and log.jsonl."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(settings.seed)
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    recipe = Recipe(settings, device, asked.retroreflective, asked.shadows, asked.solid, asked.first)
    with (folder / "log.jsonl").open("a") as file, PreparedFeed(recipe, asked.processes, asked.slots) as feed:
        steps = Steps(settings, device)
        in_flight = None if device == "cpu" else InFlight()
        if in_flight is not None:
            pin(feed.rings)
        scans = made_on(device, settings)
        kept = KeptScans(feed, device, settings.batch, asked.capacity, asked.uses, settings.seed)
        log = Log(file, steps, kept)

        def keep() -> None:
            """Write the running mean of the weights, and say how good it is."""
            seconds = time.monotonic() - began
            figures: dict[str, float] = with_average(
                steps.average, steps.parameters, lambda: validate(steps.model, settings, device, made=scans)
            )
            about = about_run(settings, steps.model, steps.taken, seconds, figures, BegunWith(steps.before, []))
            save_weights(folder, steps.model, steps.average, about | {"scans": kept.arrived})
            samples = steps.taken * settings.batch
            log.say(step=steps.taken, samples=samples, scans=kept.arrived, seconds=seconds, validation=figures)

        keep()
        over, checks, first = 0.0, [0.25, 0.5, 0.75], time.monotonic()
        while over < 1:
            with log.waiting():
                size, rows, image = kept.next()
            kept.put_into(steps.inputs(size), size, rows, image)
            rate = rate_at(settings, over)
            steps.take(size, rate)
            if in_flight is not None:
                in_flight.another()
            now = time.monotonic()
            over = (now - first) / (60 * asked.minutes - (first - began))
            log.say_at_times(now, began, rate)
            if checks and over > checks[0]:
                checks.pop(0)
                keep()
        keep()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--processes", type=int, default=max(1, (os.cpu_count() or 2) - 1), help="that make scans")
    parser.add_argument("--slots", type=int, default=16, help="scans that each may have waiting")
    parser.add_argument("--capacity", type=int, default=3000, help="scans of each size that are kept on the GPU")
    parser.add_argument("--uses", type=float, default=8.0, help="times that a scan is learned from, on average")
    parser.add_argument("--retroreflective", type=float, default=0.06, help="share of scenes of such surfaces")
    parser.add_argument("--shadows", type=float, default=0.5, help="share of scenes whose surfaces hide each other")
    parser.add_argument("--solid", type=float, default=0.7, help="share of these whose sides and rears send light")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    asked = parser.parse_args()
    said = yaml.safe_load(asked.file.read_text(encoding="utf-8"))
    train_for(TrainSettings.model_validate_json(json.dumps(said)), asked.folder, asked)


if __name__ == "__main__":
    main()
