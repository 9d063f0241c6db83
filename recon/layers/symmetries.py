"""The mirror images of a wall: what is measured on it and what is seen behind it turn over together."""

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torch import Tensor

from nlos.recon.layers.side_by_side import side_by_side
from nlos.recon.parts import counted

Fields = Sequence[Tensor | None]


def mirrored(x: Tensor, flips: Sequence[int], turned: bool) -> Tensor:
    """Flipped along the wall axes named, then transposed if turned."""
    flipped = x.flip(tuple(flips)) if flips else x
    return flipped.transpose(-1, -2) if turned else flipped


def mirrored_back(x: Tensor, flips: Sequence[int], turned: bool) -> Tensor:
    """The inverse of `mirrored`."""
    return mirrored(x.transpose(-1, -2) if turned else x, flips, False)


def mean_over_symmetries(see: Callable[[Fields], Sequence[Tensor]], fields: Fields, square: bool) -> list[Tensor]:
    """The mean of what `see` makes of every mirror image of `fields`, each (B, ..., H, W) or None, mirrored back.

    `see` is given two images at a time, (2 B, ..., H, W): a single small volume takes PyTorch's slow convolution. Four
    images, of a square wall all eight. Small pairs are done side by side.
    """
    pairs = [(turned, across) for turned in (False, True)[: 1 + square] for across in ((), (-2,))]

    def seen_of(turned: bool, across: tuple[int, ...]) -> list[list[Tensor]]:
        """What is seen in either image of a pair."""
        pair = (across, (*across, -1))
        images = [None if x is None else torch.cat([mirrored(x, flips, turned) for flips in pair]) for x in fields]
        seen = see(images)
        return [[mirrored_back(x.chunk(2)[k], flips, turned) for x in seen] for k, flips in enumerate(pair)]

    made = side_by_side([partial(seen_of, *pair) for pair in pairs], fields[0])
    total: list[Tensor] = []
    for images in counted(made, len(pairs), "mirror images"):
        for back in images:
            total = back if not total else [a + b for a, b in zip(total, back, strict=True)]
    return [x / (4 * (1 + square)) for x in total]
