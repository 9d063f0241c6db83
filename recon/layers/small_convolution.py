"""A convolution in three dimensions by the fast library also where torch takes the volume for too small for it."""

import torch
from torch import Tensor, nn


class SmallConv3d(nn.Conv3d):
    """`nn.Conv3d`, its results to rounding. Of one volume whose batch, channels and first two sides multiply to less
    than 20,480 torch chooses a loop that is twelve times slower than oneDNN on a CPU (ATen's `use_mkldnn`).

    With `by_bfloat16` it multiplies in that where nothing is learned, adds up in float32, and returns float32; with
    `gives_bfloat16` that as well.
    """

    by_bfloat16, gives_bfloat16 = False, False

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        fast = (
            not torch.is_grad_enabled()
            and input.device.type == "cpu"
            and (input.dtype == torch.float32 or self.by_bfloat16)
            and weight.dtype == torch.float32
            and isinstance(self.padding, tuple)
            and self.padding_mode == "zeros"
            and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        )
        if not fast or input.ndim != 5 or not input.numel():
            own: Tensor = super()._conv_forward(input, weight, bias)
            return own
        padding = [int(side) for side in self.padding]
        if self.by_bfloat16:
            input, weight = input.bfloat16(), weight.bfloat16()
            bias = None if bias is None else bias.bfloat16()
        out: Tensor = torch.mkldnn_convolution(input, weight, bias, padding, self.stride, self.dilation, self.groups)
        return out if self.gives_bfloat16 else out.float()
