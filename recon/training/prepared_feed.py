"""Scans made and prepared for NANO's operator by many processes on one GPU, handed over through shared memory.

Each process makes scenes, renders and measures them, and does all that NANO does without learning: noise, rates, Wiener
volumes. What learns then only learns. Volumes go through memory in half precision.
"""

import os
import signal
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from nlos.recon.errors import ReconstructionFailed
from nlos.recon.layers.wiener_volumes import VOLUMES, WienerVolumes
from nlos.recon.methods.nano import CONDITIONS, Nano
from nlos.recon.training.batches import pooled, whole_scan
from nlos.recon.training.dataset import samples_of_scene
from nlos.recon.training.network import build
from nlos.recon.training.told import told
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import load_weights

STEP = 16
"""Slices: volumes reach to a multiple of it, so that few sizes occur."""
TOGETHER = 4
"""Scans that are prepared at a time, as what starts the work takes longest."""
PATIENCE_S = 120.0
SCALARS = CONDITIONS + 2
"""Noise level, background, share of the points, the response's width, and whether there is light."""
TRUTH = ("intensity", "coverage", "depth_m")
USED = ("counts", "exposure", "background", "response", "albedo", *TRUTH)


class Size(NamedTuple):
    """Points a side, and slices."""

    points: int
    slices: int

    @property
    def volumes(self) -> int:
        """Values of a scan's volumes."""
        return VOLUMES * self.slices * self.points**2

    @property
    def others(self) -> int:
        """Values of all else."""
        return SCALARS + (2 + len(TRUTH)) * self.points**2


class Made(NamedTuple):
    """One scan: volumes (V, D, H, W), scalars (SCALARS,), maps (2, H, W), truth (len(TRUTH), H, W)."""

    volumes: Tensor
    scalars: Tensor
    maps: Tensor
    truth: Tensor

    @property
    def size(self) -> Size:
        return Size(self.volumes.shape[-1], self.volumes.shape[1])

    @property
    def others(self) -> Tensor:
        """All but the volumes, in one row."""
        return torch.cat((self.scalars, self.maps.flatten(), self.truth.flatten()))


class Place(NamedTuple):
    """Where a scan lies: in the ring of which process, and where there."""

    process: int
    slot: int


@dataclass(frozen=True)
class Recipe:
    """What the scans are like, and where they are made. `retroreflective` and `shadows` are shares of the scenes: of
    such surfaces, and with surfaces that hide each other from the wall; of these `solid` is the share whose sides and
    rears send light, too. `first` numbers the first scene."""

    settings: TrainSettings
    device: str
    retroreflective: float = 0.0
    shadows: float = 0.0
    solid: float = 0.0
    first: int = 0


@dataclass(frozen=True)
class Ring:
    """`slots` places of one process in a file that both map."""

    path: Path
    slots: int
    largest: Size

    def fields(self) -> tuple[Tensor, Tensor]:
        """The volumes in half precision, and all else, (slots, n) each; places are filled from the left."""
        split, whole = 2 * self.slots * self.largest.volumes, 4 * self.slots * self.largest.others
        held = torch.from_numpy(np.memmap(self.path, np.uint8, "r+", shape=split + whole))
        volumes, others = held[:split].view(torch.float16), held[split:].view(torch.float32)
        return volumes.view(self.slots, -1), others.view(self.slots, -1)

    def reserve(self) -> None:
        """Give the file its size."""
        with self.path.open("wb") as file:
            file.truncate(self.slots * (2 * self.largest.volumes + 4 * self.largest.others))


class PreparedFeed:
    """A context in which so many processes make scans."""

    def __init__(self, recipe: Recipe, processes: int, slots: int) -> None:
        context, data = get_context("spawn"), recipe.settings.data
        reaching = WienerVolumes(data.wall, data.time).slices
        memory = Path("/dev/shm")
        self._folder = tempfile.TemporaryDirectory(prefix="nlos-feed-", dir=memory if memory.is_dir() else None)
        self._filled: Queue[tuple[Place, Size]] = context.Queue()
        self._free: list[Queue[int]] = []
        self.rings: list[tuple[Tensor, Tensor]] = []
        self._processes = []
        for number in range(processes):
            ring = Ring(Path(self._folder.name) / str(number), slots, Size(data.rows, reaching))
            ring.reserve()
            self.rings.append(ring.fields())
            free: Queue[int] = context.Queue()
            for slot in range(slots):
                free.put(slot)
            self._free.append(free)
            told = (recipe, number, processes, ring, free, self._filled)
            self._processes.append(context.Process(target=_produce, args=told, daemon=True))

    def __enter__(self) -> Self:
        for process in self._processes:
            process.start()
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.join()
        self._folder.cleanup()

    def arrived(self) -> Iterator[tuple[Place, Size]]:
        """Scans that came since they were asked for. Each place is to be given back."""
        with suppress(Empty):
            while True:
                yield self._filled.get_nowait()

    def next(self) -> tuple[Place, Size]:
        """The next scan. Raises ReconstructionFailed where none comes for PATIENCE_S, or nobody is left to make one."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s and any(process.is_alive() for process in self._processes):
            with suppress(Empty):
                return self._filled.get(timeout=1.0)
        raise ReconstructionFailed(
            f"no scan was made in {PATIENCE_S:g} s, or all processes that make them have died: what they said is above"
        )

    def read(self, place: Place, size: Size) -> tuple[Tensor, Tensor]:
        """What lies there: volumes in half precision (n,), and all else (n,)."""
        volumes, others = self.rings[place.process]
        return volumes[place.slot, : size.volumes], others[place.slot, : size.others]

    def give_back(self, place: Place) -> None:
        """Its scan was read."""
        self._free[place.process].put(place.slot)


def _produce(
    recipe: Recipe, number: int, of: int, ring: Ring, free: "Queue[int]", filled: "Queue[tuple[Place, Size]]"
) -> None:
    """Scenes `number`, `number` + `of` ..., until it is killed."""
    torch.set_num_threads(1)
    os.environ.setdefault("CUDA_MPS_CLIENT_PRIORITY", "1")  # what learns goes first, where MPS shares the GPU
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    volumes, others = ring.fields()
    for made in Maker(recipe).scans(count(recipe.first + number, of)):
        slot = free.get()
        volumes[slot, : made.size.volumes].copy_(made.volumes.flatten())
        others[slot, : made.size.others].copy_(made.others)
        filled.put((Place(number, slot), made.size))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


class Maker:
    """Makes scans and prepares them, those of one kind together."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._networks: dict[tuple[int, int], Nano] = {}
        self._reached: list[int] = []

    def scans(self, scenes: Iterator[int]) -> Iterator[Made]:
        """Of these scenes, in the order in which they are ready."""
        waiting: dict[tuple[int, int, bool, bool], list[dict[str, Tensor]]] = defaultdict(list)
        for scene in scenes:
            for falloff, batch in self.measured(scene):
                points = batch["intensity"].shape[-1]
                is_told = bool(told(self.network(points, falloff), batch))
                same = waiting[points, falloff, is_told, whole_scan(batch)]
                same.append(batch)
                if len(same) == TOGETHER:
                    yield from self.prepared({name: torch.cat([x[name] for x in same]) for name in USED}, falloff)
                    same.clear()

    def measured(self, scene: int) -> Iterator[tuple[int, dict[str, Tensor]]]:
        """Falloff, and what was measured, as batches of one."""
        settings, device = self.recipe.settings, self.recipe.device
        rng = np.random.default_rng((settings.seed, scene, 21))
        shiny, shadows = (bool(x < share) for x, share in zip(
            rng.random(2), (self.recipe.retroreflective, self.recipe.shadows), strict=True
        ))  # fmt: skip
        solid = shadows and self.recipe.solid > 0 and bool(rng.random() < self.recipe.solid)
        data = settings.data.model_copy(update={"retroreflective": shiny, "shadows": shadows, "solid": solid})
        for each in samples_of_scene(data, scene, device):
            whole = collate([each])
            batch = {name: whole[name].to(device) for name in USED}
            if rng.random() < settings.pooled_share and whole_scan(batch):
                batch = pooled(batch)
            yield 2 if shiny else 4, batch

    def prepared(self, batch: dict[str, Tensor], falloff: int) -> Iterator[Made]:
        """The scans of a batch, one by one, each as deep as it reaches."""
        network = self.network(batch["intensity"].shape[-1], falloff)
        with torch.no_grad():
            given = network.prepared(batch["counts"], batch["exposure"], *told(network, batch))
        eta, presence = given.conditions, given.presence[:, None]
        width = eta[:, CONDITIONS:] if eta.shape[1] > CONDITIONS else torch.zeros_like(presence)
        scalars = torch.cat((eta[:, :CONDITIONS], width, presence), dim=1).cpu()
        truth = torch.stack([batch[name] for name in TRUTH], dim=1).cpu()
        maps = given.maps.cpu()
        for k, reach in enumerate(self._reached):
            yield Made(given.volumes[k, :, :reach].half().cpu(), scalars[k], maps[k], truth[k])

    def network(self, points: int, falloff: int) -> Nano:
        """What prepares scans of so many points a side; volumes reach to a multiple of STEP slices."""
        known = self._networks.get((points, falloff))
        if known is None:
            settings = self.recipe.settings
            data = settings.data.model_copy(update={"rows": points, "cols": points})
            own = settings.model_copy(update={"method_settings": settings.method_settings | {"falloff": falloff}})
            made = build(own, data.wall, data.time)
            assert isinstance(made, Nano)
            if settings.start_from:
                load_weights(made, settings.start_from)
            known = self._networks[points, falloff] = made.to(self.recipe.device)
            exactly, most = made.reach, made.physics.slices

            def reach(net: Tensor) -> tuple[int, int]:
                self._reached = [min(most, -(-exactly(net[k : k + 1])[1] // STEP) * STEP) for k in range(len(net))]
                return 0, max(self._reached)

            made.reach = reach  # type: ignore[method-assign]
        return known


def batch_of(volumes: Tensor, others: Tensor, size: Size) -> dict[str, Tensor]:
    """Views of rows as they lie in rings: (B, n) each -> volumes (B, V, D, H, W), scalars (B, SCALARS), maps
    (B, 2, H, W), and the truth by its names (B, H, W)."""
    points, area = size.points, size.points**2
    maps, truth = others[:, SCALARS : SCALARS + 2 * area], others[:, SCALARS + 2 * area :]
    return {
        "volumes": volumes.view(-1, VOLUMES, size.slices, points, points),
        "scalars": others[:, :SCALARS],
        "maps": maps.view(-1, 2, points, points),
        **{name: truth[:, k * area : (k + 1) * area].view(-1, points, points) for k, name in enumerate(TRUTH)},
    }
