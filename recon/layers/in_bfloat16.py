"""A trained network's convolutions in bfloat16: half the time where the processor multiplies in it, and as good."""

import torch
from torch import nn

from nlos.recon.layers.physical_unfolding import PhysicalUnfolding
from nlos.recon.layers.residual_block import ResidualBlock
from nlos.recon.layers.small_convolution import SmallConv3d


def in_bfloat16(network: nn.Module) -> None:
    """Lets the convolutions in three dimensions of `network` multiply in bfloat16: on a CPU, nothing being learned. The
    operator's volumes stay in it from one to the next: to convert, add up and clip them takes as long as the rest.
    A processor that oneDNN has no such convolutions for (x86 without AVX-512) goes on in float32."""
    if not bfloat16_is_there():
        return
    for part in network.modules():
        if isinstance(part, PhysicalUnfolding):
            for inner in part.modules():
                if isinstance(inner, SmallConv3d):
                    inner.gives_bfloat16 = True
        if isinstance(part, SmallConv3d):
            part.by_bfloat16 = True
        if isinstance(part, ResidualBlock) and isinstance(part.first, SmallConv3d):
            part.first.gives_bfloat16 = True  # what comes next is a ReLU


def bfloat16_is_there() -> bool:
    """Whether convolutions in bfloat16 can be had on this processor, slow ones included."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return False
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def bfloat16_is_fast() -> bool:
    """Whether this processor multiplies in bfloat16; elsewhere it is imitated, which takes longer than float32."""
    asked = getattr(torch.cpu, "get_capabilities", None)  # not in the oldest torch that will do
    known = {} if asked is None else asked()
    return bool(known.get("avx512_bf16") or known.get("amx_bf16"))
