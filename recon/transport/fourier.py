"""Fourier transforms where they are fastest: scipy's on a CPU, torch's on a GPU, and not over zeros nobody asked for.

On the CPUs measured, scipy's pocketfft is two to three times faster than torch's MKL at these sizes, works in place,
and lets go of the interpreter's lock, so that blocks of a volume go through it in threads. Operators therefore compute
on "arrays": NumPy's on a CPU, tensors elsewhere; the functions here take both. Nothing here is recorded by autograd:
`linear.py` gives whole operators their gradient.
"""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
import scipy.fft
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


def array_of(x: torch.Tensor) -> Array:
    """What to compute on: the tensor's memory as a NumPy array on a CPU, the tensor itself elsewhere."""
    return x.detach().numpy() if x.device.type == "cpu" else x.detach()


def each(work: Callable[[T], None], items: Iterable[T], like: Array) -> None:
    """work(item) for each: on as many threads as torch may use for NumPy arrays, in turn for tensors.

    The first error is raised.
    """
    if isinstance(like, np.ndarray):
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:
            for _ in pool.map(work, items):
                pass
    else:
        for item in items:
            work(item)


def fft(x: Array, axis: int, size: int | None = None) -> Array:
    """Complex FFT along `axis`, zero-padded to `size`; without a size, an array may be overwritten."""
    if isinstance(x, np.ndarray):
        return scipy.fft.fft(x, n=size, axis=axis, overwrite_x=size is None)
    return torch.fft.fft(x, n=size, dim=axis)


def ifft(x: Array, axis: int, size: int | None = None) -> Array:
    """Inverse complex FFT along `axis`, zero-padded to `size`; without a size, an array may be overwritten."""
    if isinstance(x, np.ndarray):
        return scipy.fft.ifft(x, n=size, axis=axis, overwrite_x=size is None)
    return torch.fft.ifft(x, n=size, dim=axis)


def half_spectrum(
    x: torch.Tensor, padded: int, padded_rows: int | None = None, planes: slice = slice(None)
) -> torch.Tensor:
    """The half spectra of (N, T, H, W) along T, zero-padded: (N, F, H, W), made a few rows at a time.

    With `padded_rows` there is room for that many rows, the new ones 0; with `planes` only those frequencies are kept.
    """
    samples, _, rows, cols = x.shape
    kind = torch.complex128 if x.dtype == torch.float64 else torch.complex64
    kept = len(range(padded // 2 + 1)[planes])
    spectrum = torch.empty((samples, kept, padded_rows or rows, cols), dtype=kind, device=x.device)
    spectrum[:, :, rows:] = 0
    signal, done = array_of(x), array_of(spectrum)

    def work(some: slice) -> None:
        part = signal[:, :, some]
        if isinstance(part, np.ndarray):
            done[:, :, some] = scipy.fft.rfft(part, n=padded, axis=1)[:, planes]
        else:
            done[:, :, some] = torch.fft.rfft(part, n=padded, dim=1)[:, planes]

    each(work, _row_blocks(x, padded, 1), signal)
    return spectrum


def add_signal_(signal: torch.Tensor, spectrum: torch.Tensor, padded: int, planes: slice = slice(None)) -> None:
    """signal (N, T, H, W) += the beginning of what has the half spectra (N, F, H, W) at `planes` and 0 elsewhere."""
    kept, frequencies = signal.shape[1], padded // 2 + 1
    half, done = array_of(spectrum), array_of(signal)

    def work(some: slice) -> None:
        part = half[:, :, some]
        if part.shape[1] < frequencies:
            shape = (part.shape[0], frequencies, *part.shape[2:])
            placed = np.zeros(shape, part.dtype) if isinstance(part, np.ndarray) else part.new_zeros(shape)
            placed[:, planes] = part
            part = placed
        if isinstance(part, np.ndarray):
            done[:, :, some] += scipy.fft.irfft(part, n=padded, axis=1)[:, :kept]
        else:
            done[:, :, some] += torch.fft.irfft(part, n=padded, dim=1)[:, :kept]

    each(work, _row_blocks(signal, padded, 8), half)


def _row_blocks(x: torch.Tensor, padded: int, share: int) -> list[slice]:
    samples, _, rows, cols = x.shape
    budget = (CPU_BLOCK_BYTES if x.device.type == "cpu" else CUDA_BLOCK_BYTES) // share
    return _blocks(rows, samples * padded * cols * x.element_size(), budget)


def _blocks(count: int, bytes_each: int, budget: int) -> list[slice]:
    step = max(1, min(count, budget // bytes_each))
    return [slice(first, min(first + step, count)) for first in range(0, count, step)]


def filter_planes_(spectrum: torch.Tensor, padded: tuple[int, int], multiply: Multiply) -> None:
    """Circularly convolves every (H, W) plane of `spectrum` (N, F, H, W) in space, zero-padded to `padded`, in place.

    `multiply(block, planes)` multiplies the planes' spatial spectra (N, f, *padded) in place by the filter. Planes go
    through small buffers, one a thread, so the padded volume never exists.
    """
    samples, planes, rows, cols = spectrum.shape
    budget = CPU_BLOCK_BYTES if spectrum.device.type == "cpu" else CUDA_BLOCK_BYTES
    chunks = _blocks(planes, samples * padded[0] * padded[1] * spectrum.element_size(), budget)
    whole = array_of(spectrum)
    own = threading.local()

    def on_cpu(chosen: slice) -> None:
        if not hasattr(own, "buffer"):
            own.buffer = np.empty((samples, chunks[0].stop, *padded), whole.dtype)
        block = own.buffer[:, : chosen.stop - chosen.start]
        filled = block[:, :, :rows]
        block[:, :, rows:] = 0
        filled[..., cols:] = 0
        filled[..., :cols] = whole[:, chosen]
        for part, axis in ((filled, -1), (block, -2)):
            scipy.fft.fft(part, axis=axis, overwrite_x=True)
        multiply(block, chosen)
        for part, axis in ((block, -2), (filled, -1)):
            scipy.fft.ifft(part, axis=axis, overwrite_x=True)
        whole[:, chosen] = filled[..., :cols]

    def on_gpu(chosen: slice) -> None:
        block = fft(fft(whole[:, chosen], -1, padded[1]), -2, padded[0])
        multiply(block, chosen)
        whole[:, chosen] = ifft(ifft(block, -2)[:, :, :rows], -1)[..., :cols]

    each(on_cpu if isinstance(whole, np.ndarray) else on_gpu, chunks, whole)


def multiply_even_(block: Array, quadrant: Array) -> None:
    """block (..., Y, X) *= a filter even in both frequencies, given as its quadrant (..., Y // 2 + 1, X // 2 + 1)."""
    rows, cols = block.shape[-2] // 2 + 1, block.shape[-1] // 2 + 1
    numpy = isinstance(block, np.ndarray)
    flip: Any = np.flip if numpy else torch.flip
    shape = (*quadrant.shape[:-1], block.shape[-1])
    half = np.empty(shape, quadrant.dtype) if numpy else quadrant.new_empty(shape)
    half[..., :cols] = quadrant
    half[..., cols:] = flip(quadrant[..., 1 : block.shape[-1] - cols + 1], (-1,))
    block[..., :rows, :] *= half
    block[..., rows:, :] *= flip(half[..., 1 : block.shape[-2] - rows + 1, :], (-2,))


def cast(x: Array, kind: str) -> Array:
    """As "float32", "int64" ..."""
    return x.astype(kind) if isinstance(x, np.ndarray) else x.to(getattr(torch, kind))
