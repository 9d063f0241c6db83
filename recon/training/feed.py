"""What a network in training is fed with: batches in their order, made ahead by processes or by a thread.

A sample is a function of (settings, its number) alone, so a run is bit-equal however many processes make its samples.
"""

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from pathlib import Path
from typing import Self

import torch

from nlos.recon.control_group import processors
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.training.batches import USED, indices_at
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import TrainingSample, collate

AHEAD = 2
"""Batches that are being made while one is learned from, beside one sample a process."""
WORTH_SAMPLES = 500
"""Processes take seconds to start: for fewer samples a thread makes them."""
MOST_WORKERS = 8


class Feed:
    """Batches from step `first` on; `part` is what this process has of each. A context: its processes end with it."""

    def __init__(self, settings: TrainSettings, part: slice, first: int, workers: int) -> None:
        self._settings, self._part, self._next = settings, part, first
        self._pool: Executor = _processes(workers) if workers else ThreadPoolExecutor(1)
        self._ahead = AHEAD + -(-workers // len(range(*part.indices(settings.batch))))
        self._waiting: deque[list[Future[TrainingSample]]] = deque()
        self.waited_s = 0.0
        """Seconds for which the network has waited for samples, the first ones not counted."""
        self._first = True

    def batch(self) -> dict[str, torch.Tensor]:
        """The next batch. Raises what making a sample raises, `ReconstructionFailed` where a process was killed."""
        began = time.monotonic()
        try:
            while len(self._waiting) < self._ahead:
                self._waiting.append(self._begun(min(self._next, self._settings.steps - 1)))
                self._next += 1
            whole = collate([future.result() for future in self._waiting.popleft()])
        except BrokenProcessPool as error:
            raise ReconstructionFailed(
                "a process that makes samples was killed, by the system if memory ran out, or could not start: a "
                "script trains under `if __name__ == '__main__':`. What was learned is saved: the same command "
                "resumes; fewer `workers` take less memory."
            ) from error
        self.waited_s += 0.0 if self._first else time.monotonic() - began
        self._first = False
        return {name: whole[name] for name in USED}

    def _begun(self, step: int) -> list[Future[TrainingSample]]:
        settings = self._settings
        numbers = indices_at(len(settings.data), settings.seed, step, settings.batch, self._part)
        return [self._pool.submit(_made, settings.data, number, settings.cache_path) for number in numbers]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


def workers_for(settings: TrainSettings, samples: int, world: int, device: str) -> int:
    """How many processes make samples: as told, else one beside each network on a CPU, and the cores beside a GPU."""
    if settings.workers is not None:
        return settings.workers
    if samples < WORTH_SAMPLES:
        return 0
    if device == "cpu":
        return 1
    return max(1, min(MOST_WORKERS, processors() // world - 1))


def _made(data: DatasetSettings, number: int, cache: Path | None) -> TrainingSample:
    return sample(data, number, cache)


def _processes(workers: int) -> ProcessPoolExecutor:
    """Fresh interpreters: a fork would inherit locks that PyTorch's threads hold."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """A worker computes on one core, is ended by its parent and not by the terminal, and does not outlive it."""
    torch.set_num_threads(1)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end_with_parent() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
