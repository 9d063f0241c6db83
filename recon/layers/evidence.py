"""What NANO knows beside its picture that tells how far it may be off: the evidence its intervals are made from."""

import torch
from torch import Tensor

from nlos.recon.layers.light_left_over import CHANNELS
from nlos.recon.layers.prepared import Prepared
from nlos.recon.layers.refinement import Refined
from nlos.recon.layers.volume_projection import Projection

LEFT_OVER = ("asked", "ratio", "step", "depth_step", "certainty", "misfit", "width")
"""Of what the light says of a picture, what tells how far it may be off."""

NAMES = (
    "albedo", "albedo_spread", "depth", "depth_spread", "peak", "width", "elsewhere", "brightness",
    "highest_soft", "highest_sharp", "at_depth", "depth_differs", "pulse", "exposure", "sure", "noise", "background",
    "kept", "points", "radius", "response", "brightened", "deepened",
    *(f"left_{name}" for name in LEFT_OVER),
)  # fmt: skip
"""One channel each; lengths in slices of the Wiener volumes or wall widths, brightness over the brightest point. From
`brightened` on they are the refinement's: what it changed, and what it went by; 0 where it left a picture as it was."""
UNTOLD = -1.0  # of `response`, where none is told
TOLD = 3  # noise level, background, share of the points
AROUND = 3  # slices that belong to a surface
LONG = 10  # slices that a slow response spreads it over


def evidence(seen: Projection, refined: Refined, given: Prepared, depths: Tensor) -> Tensor:
    """(B, len(NAMES), H, W) from what the operator saw and how it spreads over the wall's mirror images, the picture as
    it was refined, and what the operator was given. `depths` are the planes, in wall widths."""
    volumes, conditions, maps, presence = given.volumes, given.conditions, given.maps, given.presence
    depths, present = depths[: volumes.shape[2]], presence[:, None, None]
    width = conditions[:, TOLD] if conditions.shape[1] > TOLD else torch.full_like(presence, UNTOLD, dtype=depths.dtype)
    albedo, depth, volume = (refined.albedo * present).clamp(0, 1), refined.depth, seen.volume * present[..., None]
    spreads = seen.spreads or (torch.zeros_like(albedo), torch.zeros_like(albedo))
    slices = torch.arange(len(depths), device=albedo.device, dtype=albedo.dtype)[None, :, None, None]
    slice_depth = depths[1] - depths[0]
    total = volume.sum(dim=1)
    share = volume / total.clamp(min=1e-6)[:, None]
    peak, index = share.max(dim=1)
    mean = (share * slices).sum(dim=1)
    spread = (share * (slices - mean[:, None]).square()).sum(dim=1).clamp(min=0).sqrt()
    elsewhere = (share * ((slices - index[:, None]).abs() > AROUND)).sum(dim=1)
    soft, place = volumes[:, 0].max(dim=1)
    at = ((depth - depths[0]) / slice_depth).round().long().clamp(0, len(depths) - 1)
    around = ((slices - at[:, None]).abs() <= LONG) * volumes[:, 0].clamp(min=0)
    pulse = around.sum(dim=1) / around.amax(dim=1).clamp(min=0.02) / LONG
    rows, cols = albedo.shape[1:]
    y = torch.linspace(-1, 1, rows, device=albedo.device)[:, None]
    x = torch.linspace(-1, 1, cols, device=albedo.device)
    flat = torch.ones_like(albedo)
    fields = (
        albedo,
        spreads[0],
        depth - 0.5,
        spreads[1] / slice_depth / 4,
        peak,
        spread / 8,
        elsewhere,
        (total + 1e-3).log10() / 3,
        soft,
        volumes[:, 1].amax(dim=1),
        volumes[:, 0].gather(1, at[:, None])[:, 0],
        ((place - at).to(albedo) / 16).clamp(-2, 2),
        pulse,
        maps[:, 0],
        maps[:, 1],
        *(flat * told[:, None, None] for told in conditions[:, :TOLD].unbind(dim=1)),
        flat * torch.tensor(float(cols)).log2().sub(5),
        (x.square() + y.square()) * flat,
        flat * width[:, None, None],
        4 * (albedo - (seen.albedo * present).clamp(0, 1)),
        (depth - seen.depth) / slice_depth,
        *(refined.found[:, CHANNELS.index(name)] for name in LEFT_OVER),
    )
    return torch.stack(fields, dim=1).nan_to_num(0.0, 8.0, -8.0).clamp(-8, 8)
