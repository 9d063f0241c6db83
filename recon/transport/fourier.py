"""Fourier transforms where they are fastest: scipy's on a CPU, torch's on a GPU, and not over zeros nobody asked for.

On the CPUs measured, scipy's pocketfft is two to three times faster than torch's MKL at these sizes, works in place,
and lets go of the interpreter's lock, so that blocks of a volume go through it in threads. Operators therefore compute
on "arrays": NumPy's on a CPU, tensors elsewhere; the functions here take both, and need torch only for tensors. Nothing
here is recorded by autograd: `linear.py` gives whole operators their gradient.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from nlos.recon.control_group import processors
from nlos.recon.parts import counted

if TYPE_CHECKING:
    import torch

T = TypeVar("T")
Array = Any
"""A NumPy array or a tensor."""
Multiply = Callable[[Array, slice], None]

CPU_BLOCK_BYTES = 4 << 20  # what the padded planes under way may take: about one core's share of the cache
CUDA_BLOCK_BYTES = 1 << 30


def good_size(at_least: int) -> int:
    """The next length that transforms fast, not below `at_least`; even, so that half spectra end on Nyquist."""
    size = at_least + at_least % 2
    while (good := int(scipy.fft.next_fast_len(size, real=True))) % 2:
        size = good + 1
    return good


def array_of(x: "torch.Tensor") -> Array:
    """What to compute on: the tensor's memory as a NumPy array on a CPU, the tensor itself elsewhere."""
    return x.detach().numpy() if x.device.type == "cpu" else x.detach()


def tensor_of(x: Array) -> "torch.Tensor":
    """The reverse of `array_of`."""
    import torch

    return torch.from_numpy(x) if isinstance(x, np.ndarray) else x


def beside(x: Array, constant: npt.NDArray[Any]) -> Array:
    """A NumPy constant where `x` is, of its type."""
    if isinstance(x, np.ndarray):
        return constant.astype(x.dtype)
    import torch

    return torch.from_numpy(constant).to(x.device, x.dtype)


def empty(x: Array, shape: tuple[int, ...], complex_: bool = False) -> Array:
    """An array of that shape where `x` is, of its precision."""
    if isinstance(x, np.ndarray):
        return np.empty(shape, np.result_type(x.dtype, np.complex64) if complex_ else x.dtype)
    return x.new_empty(shape, dtype=x.dtype.to_complex() if complex_ else x.dtype)


_own = threading.local()


@contextmanager
def on_one_core() -> Iterator[None]:
    """While the block lasts, this thread computes alone: others have the other cores."""
    torch = sys.modules.get("torch")
    shared = torch.get_num_threads() if torch is not None else 0
    before, _own.alone = getattr(_own, "alone", False), True
    if torch is not None and shared > 1:
        torch.set_num_threads(1)  # of this thread, and of those that begin from now on
    try:
        yield
    finally:
        _own.alone = before
        if torch is not None and shared > 1:
            torch.set_num_threads(shared)


def threads() -> int:
    """As many as torch may use; without torch what `OMP_NUM_THREADS` says, as torch takes it, else a thread for every
    processor."""
    if getattr(_own, "alone", False):
        return 1
    torch = sys.modules.get("torch")
    if torch is not None:
        return int(torch.get_num_threads())
    said = os.environ.get("OMP_NUM_THREADS", "")
    if said.isdecimal() and int(said) > 0:
        return int(said)
    return processors()


def each(work: Callable[[T], None], items: Iterable[T], like: Array) -> None:
    """work(item) for each: on as many threads as torch may use for NumPy arrays; in turn for tensors, or on one thread.

    The first error is raised.
    """
    ready = list(items)
    workers = min(threads(), len(ready)) if isinstance(like, np.ndarray) else 1
    if workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            for _ in counted(pool.map(work, ready), len(ready), "planes"):
                pass
    else:
        for item in counted(ready, len(ready), "planes"):
            work(item)


def fft(x: Array, axis: int, size: int | None = None) -> Array:
    """Complex FFT along `axis`, zero-padded to `size`; without a size, an array may be overwritten."""
    if isinstance(x, np.ndarray):
        return scipy.fft.fft(x, n=size, axis=axis, overwrite_x=size is None)
    import torch

    return torch.fft.fft(x, n=size, dim=axis)


def ifft(x: Array, axis: int, size: int | None = None) -> Array:
    """Inverse complex FFT along `axis`, zero-padded to `size`; without a size, an array may be overwritten."""
    if isinstance(x, np.ndarray):
        return scipy.fft.ifft(x, n=size, axis=axis, overwrite_x=size is None)
    import torch

    return torch.fft.ifft(x, n=size, dim=axis)


def half_spectrum(x: Array, padded: int, padded_rows: int | None = None, planes: slice = slice(None)) -> Array:
    """The half spectra of (N, T, H, W) along T, zero-padded: (N, F, H, W), made a few rows at a time.

    With `padded_rows` there is room for that many rows, the new ones 0; with `planes` only those frequencies are kept.
    """
    samples, _, rows, cols = x.shape
    kept = len(range(padded // 2 + 1)[planes])
    spectrum = empty(x, (samples, kept, padded_rows or rows, cols), complex_=True)
    spectrum[:, :, rows:] = 0

    def work(some: slice) -> None:
        part = x[:, :, some]
        if isinstance(part, np.ndarray):
            spectrum[:, :, some] = scipy.fft.rfft(part, n=padded, axis=1)[:, planes]
        else:
            import torch

            spectrum[:, :, some] = torch.fft.rfft(part, n=padded, dim=1)[:, planes]

    each(work, _row_blocks(x, padded, 1), x)
    return spectrum


def add_signal_(signal: Array, spectrum: Array, padded: int, planes: slice = slice(None)) -> None:
    """signal (N, T, H, W) += the beginning of what has the half spectra (N, F, H, W) at `planes` and 0 elsewhere."""
    kept, frequencies = signal.shape[1], padded // 2 + 1

    def work(some: slice) -> None:
        part = spectrum[:, :, some]
        if part.shape[1] < frequencies:
            shape = (part.shape[0], frequencies, *part.shape[2:])
            placed = np.zeros(shape, part.dtype) if isinstance(part, np.ndarray) else part.new_zeros(shape)
            placed[:, planes] = part
            part = placed
        if isinstance(part, np.ndarray):
            signal[:, :, some] += scipy.fft.irfft(part, n=padded, axis=1)[:, :kept]
        else:
            import torch

            signal[:, :, some] += torch.fft.irfft(part, n=padded, dim=1)[:, :kept]

    each(work, _row_blocks(signal, padded, 8), spectrum)


def _row_blocks(x: Array, padded: int, share: int) -> list[slice]:
    samples, _, rows, cols = x.shape
    return _blocks(rows, samples * padded * cols * x.itemsize, _budget(x) // share)


def _budget(x: Array) -> int:
    return CPU_BLOCK_BYTES if isinstance(x, np.ndarray) or x.device.type == "cpu" else CUDA_BLOCK_BYTES


def _blocks(count: int, bytes_each: int, budget: int) -> list[slice]:
    step = max(1, min(count, budget // bytes_each))
    return [slice(first, min(first + step, count)) for first in range(0, count, step)]


def filter_planes_(spectrum: Array, padded: tuple[int, int], multiply: Multiply) -> None:
    """Circularly convolves every (H, W) plane of `spectrum` (N, F, H, W) in space, zero-padded to `padded`, in place.

    `multiply(block, planes)` multiplies the planes' spatial spectra (N, f, *padded) in place by the filter. Planes go
    through small buffers, one a thread, so the padded volume never exists.
    """
    samples, planes, rows, cols = spectrum.shape
    chunks = _blocks(planes, samples * padded[0] * padded[1] * spectrum.itemsize, _budget(spectrum))
    own = threading.local()

    def on_cpu(chosen: slice) -> None:
        if not hasattr(own, "buffer"):
            own.buffer = np.empty((samples, chunks[0].stop, *padded), spectrum.dtype)
        block = own.buffer[:, : chosen.stop - chosen.start]
        filled = block[:, :, :rows]
        block[:, :, rows:] = 0
        filled[..., cols:] = 0
        filled[..., :cols] = spectrum[:, chosen]
        for part, axis in ((filled, -1), (block, -2)):
            scipy.fft.fft(part, axis=axis, overwrite_x=True)
        multiply(block, chosen)
        for part, axis in ((block, -2), (filled, -1)):
            scipy.fft.ifft(part, axis=axis, overwrite_x=True)
        spectrum[:, chosen] = filled[..., :cols]

    def on_gpu(chosen: slice) -> None:
        block = fft(fft(spectrum[:, chosen], -1, padded[1]), -2, padded[0])
        multiply(block, chosen)
        spectrum[:, chosen] = ifft(ifft(block, -2)[:, :, :rows], -1)[..., :cols]

    each(on_cpu if isinstance(spectrum, np.ndarray) else on_gpu, chunks, spectrum)


def multiply_even_(block: Array, quadrant: Array) -> None:
    """block (..., Y, X) *= a filter even in both frequencies, given as its quadrant (..., Y // 2 + 1, X // 2 + 1)."""
    rows, cols = block.shape[-2] // 2 + 1, block.shape[-1] // 2 + 1
    numpy = isinstance(block, np.ndarray)
    flip: Any = np.flip if numpy else type(block).flip
    shape = (*quadrant.shape[:-1], block.shape[-1])
    half = np.empty(shape, quadrant.dtype) if numpy else quadrant.new_empty(shape)
    half[..., :cols] = quadrant
    half[..., cols:] = flip(quadrant[..., 1 : block.shape[-1] - cols + 1], (-1,))
    block[..., :rows, :] *= half
    block[..., rows:, :] *= flip(half[..., 1 : block.shape[-2] - rows + 1, :], (-2,))


def cast(x: Array, kind: str) -> Array:
    """As "float32", "int64" ..."""
    if isinstance(x, np.ndarray):
        return x.astype(kind)
    import torch

    return x.to(getattr(torch, kind))
