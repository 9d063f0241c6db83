"""What the physics methods share: their settings, and the way counts become what their operators expect."""

from typing import Annotated, ClassVar

import torch
from pydantic import Field

from acquisition.transient import TimeAxis
from configs.settings import Settings
from recon.gridding import fill_unmeasured
from recon.noise import estimate, without_background
from recon.transport.conventions import Conventions


class PhysicsSettings(Settings):
    """Settings that every physics method knows."""

    has_inverse_filter: ClassVar[bool] = True
    """Whether `snr` means anything to the method."""

    snr: Annotated[float, Field(gt=0)] | None = None
    """Signal to noise ratio for the inverse; picked from the data unless given."""
    falloff: Annotated[float, Field(ge=0, le=8)] = 4.0
    """Exponent with which light fades: 4 for diffuse, 2 for retroreflective surfaces."""
    bin_width_ps: Annotated[float, Field(gt=0)] | None = None
    """Rebin to this width first; a whole multiple of the data's."""
    conventions: Conventions = "physical"
    """`physical`, or `authors` for comparison with the published programs."""


def prepare(
    counts: torch.Tensor, exposure_s: torch.Tensor | None, settings: PhysicsSettings, time: TimeAxis
) -> tuple[torch.Tensor, torch.Tensor | None, float | torch.Tensor]:
    """Counts (B, C, T, H, W) as signal alone, the part of the falloff to undo (B,) and the snr.

    Exposure is divided out, the background subtracted, points that were not measured are interpolated, and both
    choices follow from the noise found. Under the authors' conventions nothing is subtracted and all falloff undone.
    """
    rates = equally_exposed(counts, exposure_s)
    noise = estimate(rates, None if exposure_s is None else exposure_s > 0, time)
    snr: float | torch.Tensor = noise.snr() if settings.snr is None else settings.snr
    undone: torch.Tensor | None = None
    if settings.conventions == "physical":
        rates, undone = without_background(rates, noise.background), noise.undone()
    if exposure_s is not None:
        rates = fill_unmeasured(rates, exposure_s > 0)
    return rates, undone, snr


def equally_exposed(counts: torch.Tensor, exposure_s: torch.Tensor | None) -> torch.Tensor:
    """Counts (B, C, T, H, W) as if every point had been exposed for the mean exposure; 0 where none was measured."""
    if exposure_s is None or bool((exposure_s == exposure_s[:, :1, :1]).all()):
        return counts
    measured = exposure_s > 0
    mean = exposure_s.sum((-2, -1), keepdim=True) / measured.sum((-2, -1), keepdim=True).clamp(min=1)
    weight = torch.where(measured, mean / exposure_s.clamp(min=1e-30), 0.0)
    return counts * weight[:, None, None].to(counts.dtype)
