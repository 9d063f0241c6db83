"""A method's network as training builds it, and the loss that it learns from.

The network is `recon.methods.<method>.build(settings, wall, time)`; called with counts (B, 1, T, H, W) and relative
exposure (B, H, W) it returns (albedo (B, H, W), depth in metres (B, H, W), volume or None), the albedo in units of the
picture's maximum. It may instead bring its own objective, `training_loss(batch) -> {"loss": ..., ...}`, batch as
`dataset.collate` makes it. Its Settings have a field `weights`, which is None here: training begins afresh.
"""

import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import Any

import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find
from nlos.recon.training.architecture import method_settings
from nlos.recon.training.checkpoint import share_parameters
from nlos.recon.training.losses import losses
from nlos.recon.training.shallow_convolutions import ShallowInFloat32
from nlos.recon.training.told import told
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import load_weights

Objective = Callable[[Mapping[str, torch.Tensor]], dict[str, torch.Tensor]]


def networks(settings: TrainSettings, device: str) -> tuple[nn.Module, nn.Module | None, dict[str, Any]]:
    """The network for the grid of the data, the same parameters on half that grid if steps are to see it, and what
    was said about the weights that it begins with."""
    wall, time = settings.data.wall, settings.data.time
    model = build(settings, wall, time).to(device)
    before = load_weights(model, settings.start_from) if settings.start_from else {}
    if not settings.pooled_share:
        return model, None, before
    half = WallGrid(wall.width_m, wall.height_m, wall.rows // 2, wall.cols // 2)
    return model, share_parameters(model, build(settings, half, time).to(device)), before


def device_here() -> str:
    """Where this process computes: a GPU where PyTorch sees one."""
    return f"cuda:{os.environ.get('LOCAL_RANK', 0)}" if torch.cuda.is_available() else "cpu"


def half_precision(settings: TrainSettings, device: str) -> bool:
    """Whether to compute in bfloat16: where the processor has it, unless told otherwise."""
    if settings.precision != "auto":
        return settings.precision == "bf16"
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def build(settings: TrainSettings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """The method's network without weights, laid out for the processor's fastest convolutions."""
    model = find(settings.method).build(method_settings(settings), wall, time)
    model.train()
    for dims, layout in ((5, torch.channels_last_3d), (4, torch.channels_last)):
        for parameter in model.parameters():
            if parameter.ndim == dims:
                parameter.data = parameter.data.contiguous(memory_format=layout)
    return model


def objective(
    network: nn.Module, batch: Mapping[str, torch.Tensor], settings: TrainSettings, device: str
) -> dict[str, torch.Tensor]:
    """The terms of the loss and their sum, `loss`, computed in the precision of the settings."""
    kind = torch.device(device).type
    shallow = ShallowInFloat32() if kind == "cpu" else nullcontext()
    with torch.autocast(kind, torch.bfloat16, enabled=half_precision(settings, kind)), shallow:
        own: Objective | None = getattr(network, "training_loss", None)
        if own is not None:
            return own(batch)
        prediction = network(batch["counts"], batch["exposure"], *told(network, batch))
    return losses(prediction, batch, settings.loss)
