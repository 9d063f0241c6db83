"""How good a network in training is on scenes of kinds it never sees, and how the light-cone transform does there."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from nlos.recon.method import MethodResult
from nlos.recon.training.dataset import sample
from nlos.recon.training.losses import picture_of, psnr
from nlos.recon.training.told import told
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling

SNRS = (1.0, 0.1, 0.03, 0.01, 0.003)


Batch = dict[str, torch.Tensor]


def made_on(device: str, settings: TrainSettings) -> list[Batch]:
    """The validation set, measured on `device`: for who validates often and keeps it."""
    samples = (sample(settings.validation, index, device=device) for index in range(len(settings.validation)))
    return [{name: x.to(device) for name, x in collate([each]).items()} for each in samples]


def validate(
    model: nn.Module,
    settings: TrainSettings,
    device: str,
    against_lct: bool = False,
    made: Sequence[Batch] | None = None,
) -> dict[str, float]:
    """Mean PSNR at the best scale, and the depth's mean absolute error over the mask in metres, on the validation set.

    `made` holds the scans of the set, where they were made before. `against_lct` adds the light-cone transform at the
    best of five snr for each sample, and the margin over it.
    """
    data = settings.validation
    pictures, depths, rivals = [], [], []
    model.eval()
    for index in range(len(data)):
        if made is not None:
            batch = made[index]
        else:
            batch = {name: x.to(device) for name, x in collate([sample(data, index, settings.cache_path)]).items()}
        truth = picture_of(batch)
        with torch.no_grad():
            seen: MethodResult[torch.Tensor] = model(batch["counts"], batch["exposure"], *told(model, batch))
        pictures.append(float(psnr(seen.albedo.float(), truth)))
        mask = batch["depth_m"] > 0
        depths.append(float((seen.depth_m.float() - batch["depth_m"])[mask].abs().nanmean()))
        if against_lct:
            rivals.append(max(float(psnr(picture, truth)) for picture in light_cone_pictures(batch, settings)))
    model.train()
    known = [depth for depth in depths if not math.isnan(depth)]  # none where a network sees nothing yet
    figures = {"psnr": float(np.mean(pictures)), "depth_mad_m": float(np.mean(known)) if known else math.nan}
    if against_lct:
        figures |= {"lct_psnr": float(np.mean(rivals)), "margin_db": float(np.mean(pictures) - np.mean(rivals))}
    return figures


def light_cone_pictures(batch: dict[str, torch.Tensor], settings: TrainSettings) -> list[torch.Tensor]:
    """Front views (B, H, W) of the centred light-cone transform without background, falloff 4, at each snr."""
    wall, time = settings.validation.wall, settings.validation.time
    exposure = batch["exposure"][:, None, None]
    net = batch["counts"] - batch["background"][:, None, None, None, None] * exposure
    rate = torch.where(exposure > 0, net / exposure.clamp(min=1e-6), 0.0)
    resampling = LightConeResampling(time)
    light = resampling(Falloff(time, 2.0 if settings.data.retroreflective else 4.0)(rate.cpu()))
    cone = LightConeConvolution(wall, time)
    return [
        resampling.adjoint(cone.wiener(light, snr)).clamp(min=0).amax(dim=2)[:, 0].to(exposure.device) for snr in SNRS
    ]
