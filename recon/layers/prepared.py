"""What NANO's operator is given of a scan."""

from typing import NamedTuple

from torch import Tensor


class Prepared(NamedTuple):
    """Of B scans of H x W points; the slices D reach as deep as there is light."""

    volumes: Tensor  # (B, V, D, H, W), the Wiener solutions
    conditions: Tensor  # (B, 3), noise level, background, share of the points; or (B, 4), last the response's width
    maps: Tensor  # (B, 2, H, W), exposure and confidence
    lifted: Tensor | None  # features of the lifting
    presence: Tensor  # (B,), whether there is any light
    first: int = 0  # the depth, counted in slices from the wall, that the volumes begin with
