"""How good a trained row is on scenes that no row was trained on: every figure of every scene, in a file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nlos.recon.layers.symmetries import Fields, mean_over_symmetries
from nlos.recon.method import MethodResult
from nlos.recon.methods import find
from nlos.recon.metrics import depth_scores, image_scores
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.losses import picture_of
from nlos.recon.training.network import build, device_here
from nlos.recon.training.run_folder import WEIGHTS
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import load_weights

FIGURES = ("psnr", "ssim", "depth_rmse_m", "depth_mad_m")
Judged = Mapping[str, Mapping[str, list[float]]]
"""Set of scenes -> figure -> one value a scene."""


class OverMirrors(torch.nn.Module):
    """The mean of what a network makes of the eight mirror images of a square wall's scan, mirrored back: counts (B, 1,
    T, H, W), exposure (B, H, W) -> albedo and depth (B, H, W), the mean of the images that say one, NaN where fewer
    than half do."""

    def __init__(self, network: torch.nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, counts: torch.Tensor, exposure: torch.Tensor) -> MethodResult[torch.Tensor]:
        def see(images: Fields) -> tuple[torch.Tensor, ...]:
            made = self.network(*images)
            said = made.depth_m.isfinite()
            return made.albedo, torch.where(said, made.depth_m, 0.0), said.to(made.albedo)

        albedo, depth_m, said = mean_over_symmetries(see, (counts, exposure), square=True)
        return MethodResult(albedo, torch.where(said < 0.5, torch.nan, depth_m / said))


def judge(
    settings: TrainSettings,
    folder: Path | None,
    to: Path,
    sets: Mapping[str, DatasetSettings],
    mirrored: bool = False,
) -> Judged:
    """Measure the weights in `folder`, None for a method without any, on every set, and write the figures `to` a file;
    `mirrored`: as the mean over mirror images, NANO by its own setting, others around what they make."""
    own = mirrored and "symmetries" in settings.method_settings
    if own:
        settings = settings.model_copy(update={"method_settings": settings.method_settings | {"symmetries": True}})
    found: dict[str, dict[str, list[float]]] = {}
    for name, data in sets.items():
        network = network_of(settings, data, folder)
        network.eval()
        network = OverMirrors(network) if mirrored and not own else network
        scenes = [scores(network, collate([sample(data, k, settings.cache_path)])) for k in range(len(data))]
        found[name] = {figure: [round(scene[figure], 5) for scene in scenes] for figure in FIGURES}
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(json.dumps(found), encoding="utf-8")
    return found


def judged(kept: Path) -> Judged | None:
    """What that file holds; None where there is none yet."""
    if not kept.exists():
        return None
    found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
    return found


def network_of(settings: TrainSettings, data: DatasetSettings, folder: Path | None) -> torch.nn.Module:
    """For the wall and time axis of `data`, with the weights in `folder`, None for a method without any."""
    if folder is None:
        method = find(settings.method)
        return method.build(method.Settings.model_validate(settings.method_settings), data.wall, data.time)
    network = build(settings, data.wall, data.time)
    load_weights(network, str(folder / WEIGHTS))
    return network.to(device_here())


def scores(network: torch.nn.Module, batch: Mapping[str, torch.Tensor]) -> dict[str, float]:
    """Every figure of the picture that `network` makes of the one scan of a batch."""
    device = next((parameter.device for parameter in network.parameters()), torch.device("cpu"))
    with torch.inference_mode():
        made = network(batch["counts"].to(device), batch["exposure"].to(device))
    albedo, depth_m = made.albedo[0].float().cpu().numpy(), made.depth_m[0].float().cpu().numpy()
    truth, true_depth_m = picture_of(batch)[0].numpy(), batch["depth_m"][0].numpy()
    return image_scores(np.clip(albedo, 0, None), truth) | depth_scores(depth_m, true_depth_m, true_depth_m > 0)
