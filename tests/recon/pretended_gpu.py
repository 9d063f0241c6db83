"""A GPU that is pretended: its tensors are a CPU's, and an operation that meets tensors of both is remembered.

PyTorch's "meta" device stands for it, whose own tensors hold nothing. So the code for GPUs runs where there is none,
with its numbers, and what would end in "Expected all tensors to be on the same device" is found.
"""

import contextlib
import traceback
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = "meta"
MAY_MEET = ("copy_", "index", "index_put", "index_put_")
"""Operations that take tensors of both: copies, and indices that PyTorch moves by itself."""

LAZY = {"_conj": torch.ops.aten.conj_physical.default, "_neg_view": torch.ops.aten.neg.default}
"""Marks that a tensor is the conjugate of what it holds would be lost on the way: it is computed."""


class OnGpu(Tensor):
    """A tensor that says it lies on the GPU; `held` is it."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "OnGpu":
        strides = held.stride() if held.layout == torch.strided else (held.shape[1], 1)
        made: OnGpu = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls, held.shape, strides=strides, dtype=held.dtype, device=DEVICE
        )
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(
        cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        return _done(func, args, dict(kwargs or {}), {})


class PretendedGpu(TorchDispatchMode):
    """While it is entered, tensors can be made there; `met`: line -> operation, where tensors of both devices met;
    `started`: how many operations a GPU would have to be told to do."""

    def __init__(self) -> None:
        super().__init__()
        self.met: dict[str, str] = {}
        self.started = 0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        self.started += not func.is_view
        return _done(func, args, dict(kwargs or {}), self.met)


def there(network: nn.Module) -> nn.Module:
    """The same network, its parameters and buffers on the pretended GPU."""
    for part in network.modules():
        for name, parameter in part._parameters.items():
            if parameter is not None:
                part._parameters[name] = nn.Parameter(OnGpu(parameter.data), requires_grad=False)
        for name, buffer in part._buffers.items():
            if buffer is not None:
                part._buffers[name] = OnGpu(buffer)
    return network


def here(x: Any) -> Any:
    """What a tensor of either holds; anything else as it is."""
    return x.held if isinstance(x, OnGpu) else x


@contextlib.contextmanager
def pretended_gpu() -> Iterator[PretendedGpu]:
    """While it lasts, what PyTorch does otherwise on this device than on a GPU is done as there."""
    multiplied, sorted_ = torch.sparse.mm, torch.Tensor.coalesce

    def sparse_mm(a: Tensor, b: Tensor) -> Tensor:
        assert isinstance(a, OnGpu) == isinstance(b, OnGpu), "torch.sparse.mm of tensors of both devices"
        out = multiplied(here(a), here(b))
        return OnGpu(out) if isinstance(a, OnGpu) else out

    def coalesce(x: Tensor) -> Tensor:
        return OnGpu(sorted_(x.held)) if isinstance(x, OnGpu) else sorted_(x)

    class NoCast(contextlib.nullcontext[None]):
        def __init__(self, *_: object, **__: object) -> None:
            super().__init__()

    with pytest.MonkeyPatch.context() as patch, torch.no_grad(), PretendedGpu() as mode:
        patch.setattr(torch.sparse, "mm", sparse_mm)
        patch.setattr(torch.Tensor, "coalesce", coalesce)
        patch.setattr(OnGpu, "new_tensor", lambda like, data: OnGpu(like.held.new_tensor(data)), raising=False)
        patch.setattr(OnGpu, "tolist", lambda x: x.held.tolist(), raising=False)
        patch.setattr(torch, "autocast", NoCast)
        patch.setattr(torch, "inference_mode", lambda *_: torch.no_grad())  # views of such tensors are not made by hand
        yield mode


def _done(func: Any, args: Sequence[Any], kwargs: dict[str, Any], met: dict[str, str]) -> Any:
    """The operation on what its tensors hold; the result lies where theirs do, or where it is asked for."""
    given = [x for x in tree_flatten((args, kwargs))[0] if isinstance(x, Tensor)]
    gpus = [x for x in given if isinstance(x, OnGpu)]
    name = func.overloadpacket.__name__
    if gpus and name not in MAY_MEET and any(x.ndim for x in given if not isinstance(x, OnGpu)):
        met[_line()] = str(func)
    on_gpu = isinstance(args[0], OnGpu) if name in ("copy_", "_to_copy") else bool(gpus)
    if (device := kwargs.get("device")) is not None:
        on_gpu, kwargs["device"] = torch.device(device).type == DEVICE, "cpu"
    out = LAZY.get(name, func)(*tree_map(here, args), **tree_map(here, kwargs))
    known = {id(x.held): x for x in gpus}

    def placed(x: Any) -> Any:
        if not on_gpu or type(x) is not Tensor:
            return x
        return known[id(x)] if id(x) in known else OnGpu(x)

    return tree_map(placed, out)


def _line() -> str:
    ours = [frame for frame in traceback.extract_stack() if "/nlos/recon/" in frame.filename]
    return f"{ours[-1].filename}:{ours[-1].lineno}" if ours else "?"
