"""Prepared scans kept on the GPU until newer ones take their place, and batches drawn from them."""

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.prepared_feed import Place, PreparedFeed, Size, batch_of


class KeptScans:
    """Each scan is to be learned from `uses` times, in other mirror images and other company; `capacity` of each size
    are kept."""

    def __init__(self, feed: PreparedFeed, device: str, batch: int, capacity: int, uses: float, seed: int) -> None:
        self._feed, self._device, self._batch, self._capacity, self._uses = feed, device, batch, capacity, uses
        self._rng = np.random.default_rng((seed, 31))
        self._rows: dict[Size, tuple[Tensor, Tensor]] = {}
        self._arrived: dict[Size, int] = {}
        self._drawn: dict[Size, int] = {}
        self._being_read: deque[tuple[Any, list[Place]]] = deque()

    @property
    def arrived(self) -> int:
        """Scans that were made."""
        return sum(self._arrived.values())

    def next(self) -> tuple[Size, list[int], int]:
        """Of which size a batch is to be taken, which scans, and the number of their mirror image; waits for some."""
        while True:
            self._take_in(self._feed.arrived())
            behind = {size: self._uses * came - self._drawn[size] for size, came in self._arrived.items()}
            size = max(behind, key=lambda each: behind[each]) if behind else None
            if size is not None and behind[size] >= self._batch and self._arrived[size] >= 2 * self._batch:
                self._drawn[size] += self._batch
                kept = min(self._arrived[size], self._capacity)
                return size, self._rng.choice(kept, self._batch, replace=False).tolist(), int(self._rng.integers(8))
            self._take_in([self._feed.next()])

    def put_into(self, inputs: tuple[Tensor, Tensor], size: Size, rows: list[int], image: int) -> None:
        """These scans, all in the same mirror image, as `inputs` of `batch_of`."""
        chosen = torch.tensor(rows, device=self._device)
        volumes, others = self._rows[size]
        held = batch_of(volumes.index_select(0, chosen), others.index_select(0, chosen), size)
        flips = [axis for axis, bit in ((-1, 1), (-2, 2)) if image & bit]
        wanted = batch_of(*inputs, size)
        for name, field in held.items():
            wanted[name].copy_(field if field.ndim < 3 else mirrored(field, flips, bool(image & 4)))

    def _take_in(self, scans: Iterable[tuple[Place, Size]]) -> None:
        places = []
        for place, size in scans:
            if size not in self._rows:
                kinds = ((size.volumes, torch.float16), (size.others, torch.float32))
                volumes, others = (torch.zeros(self._capacity, n, dtype=kind, device=self._device) for n, kind in kinds)
                self._rows[size], self._arrived[size], self._drawn[size] = (volumes, others), 0, 0
            row = self._arrived[size] % self._capacity
            for kept, new in zip(self._rows[size], self._feed.read(place, size), strict=True):
                kept[row].copy_(new, non_blocking=True)
            self._arrived[size] += 1
            places.append(place)
        if self._device == "cpu":
            self._free(places)
            return
        copied = torch.cuda.Event()  # type: ignore[no-untyped-call]
        copied.record()
        self._being_read.append((copied, places))
        while self._being_read and self._being_read[0][0].query():
            self._free(self._being_read.popleft()[1])

    def _free(self, places: list[Place]) -> None:
        for place in places:
            self._feed.give_back(place)
