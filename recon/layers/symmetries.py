"""The mirror images of a wall: what is measured on it and what is seen behind it turn over together."""

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torch import Tensor

from nlos.recon.layers.side_by_side import side_by_side
from nlos.recon.parts import counted

Fields = Sequence[Tensor | None]
MOST_TOGETHER = 1 << 26
"""Values of all images of a field on a GPU: those of 128 x 128 points and 512 bins are 2^25.6, and take about 3 GiB by
what two of them take (0.7 GiB, measured)."""


def mirrored(x: Tensor, flips: Sequence[int], turned: bool) -> Tensor:
    """Flipped along the wall axes named, then transposed if turned."""
    flipped = x.flip(tuple(flips)) if flips else x
    return flipped.transpose(-1, -2) if turned else flipped


def mirrored_back(x: Tensor, flips: Sequence[int], turned: bool) -> Tensor:
    """The inverse of `mirrored`."""
    return mirrored(x.transpose(-1, -2) if turned else x, flips, False)


def mean_over_symmetries(see: Callable[[Fields], Sequence[Tensor]], fields: Fields, square: bool) -> list[Tensor]:
    """The mean of what `see` makes of every mirror image of `fields`, each (B, ..., H, W) or None, mirrored back.

    `see` is given some images at a time, (K B, ..., H, W): two on a CPU, where a single small volume takes PyTorch's
    slow convolution, small pairs side by side; on a GPU, which waits for whoever starts its work, all unless they are
    large. Four images, of a square wall all eight.
    """
    images = [
        (turned, (*across, *along))
        for turned in (False, True)[: 1 + square]
        for across in ((), (-2,))
        for along in ((), (-1,))
    ]
    together = 2 if _a_pair_at_a_time(fields[0], len(images)) else len(images)
    groups = [images[first : first + together] for first in range(0, len(images), together)]

    def seen_of(group: Sequence[tuple[bool, tuple[int, ...]]]) -> list[list[Tensor]]:
        """What is seen in each image of a group."""
        seen = see(
            [None if x is None else torch.cat([mirrored(x, flips, turned) for turned, flips in group]) for x in fields]
        )
        return [
            [mirrored_back(x.chunk(len(group))[k], flips, turned) for x in seen]
            for k, (turned, flips) in enumerate(group)
        ]

    made = side_by_side([partial(seen_of, group) for group in groups], fields[0])
    total: list[Tensor] = []
    for images_seen in counted(made, len(groups), "mirror images"):
        for back in images_seen:
            total = back if not total else [a + b for a, b in zip(total, back, strict=True)]
    return [x / len(images) for x in total]


def _a_pair_at_a_time(field: Tensor | None, images: int) -> bool:
    return field is None or field.device.type == "cpu" or images * field.numel() > MOST_TOGETHER
