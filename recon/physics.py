"""What the physics methods share: their settings, and the way counts become what their operators expect."""

from typing import Annotated

import torch
from pydantic import Field

from configs.settings import Settings
from recon.transport.conventions import Conventions


class PhysicsSettings(Settings):
    """Settings that every physics method knows."""

    snr: Annotated[float, Field(gt=0)] | None = None
    """Signal to noise ratio for the inverse; picked from the data unless given."""
    falloff: Annotated[float, Field(ge=0, le=8)] = 4.0
    """Exponent with which light fades: 4 for diffuse, 2 for retroreflective surfaces."""
    bin_width_ps: Annotated[float, Field(gt=0)] | None = None
    """Rebin to this width first; a whole multiple of the data's."""
    conventions: Conventions = "physical"
    """`physical`, or `authors` for comparison with the published programs."""


def rates(counts: torch.Tensor, exposure_s: torch.Tensor | None) -> torch.Tensor:
    """Counts (B, C, T, H, W) as if every point had been exposed for the mean exposure; 0 where none was measured."""
    if exposure_s is None:
        return counts
    measured = exposure_s > 0
    mean = exposure_s.sum((-2, -1), keepdim=True) / measured.sum((-2, -1), keepdim=True).clamp(min=1)
    weight = torch.where(measured, mean / exposure_s.clamp(min=1e-30), 0.0)
    return counts * weight[:, None, None].to(counts.dtype)
