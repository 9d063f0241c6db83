"""Parts of a network's work side by side: a core each, where operations are too small to be shared by cores.

Two threads that share every operation of a small volume wait for each other thousands of times a picture, asleep
(decision 095): on two cores they were hardly faster than one. With a part of the work each they meet once.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

import torch
from torch import Tensor

LARGEST = 1 << 22
"""Values of a field from which on its operations are worth sharing, and memory counts for more than time."""

T = TypeVar("T")


def side_by_side(parts: Sequence[Callable[[], T]], field: Tensor | None) -> Iterator[T]:
    """What each of `parts` returns, in their order: computed at the same time on this thread's cores where `field`, the
    largest of what they work on, is small, on the CPU, and nothing is learned; else one after the other, as asked for.
    """
    threads = torch.get_num_threads()
    together = field is not None and field.device.type == "cpu" and field.numel() <= LARGEST
    if not together or threads < 2 or torch.is_grad_enabled() or torch.is_autocast_enabled("cpu"):
        for part in parts:
            yield part()
        return
    inference, workers = torch.is_inference_mode_enabled(), min(threads, len(parts))

    def alone(part: Callable[[], T]) -> T:
        torch.set_num_threads(threads // workers)  # of this thread, and of those that begin from now on
        with torch.inference_mode(inference), torch.no_grad():
            return part()

    pool = ThreadPoolExecutor(workers)
    try:
        for waiting in [pool.submit(copy_context().run, alone, part) for part in parts]:
            yield waiting.result()
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(threads)
