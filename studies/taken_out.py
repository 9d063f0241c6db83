"""What trained weights rely on: each part taken out of them at test time, on the rendered scenes.

It says how much a network trained with a part leans on it, not what that part is worth: for that the network has to be
trained without it (`make studies`). `python -m studies.taken_out ../shared/data/synthetic [METHOD] [CONDITION]`.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from nlos.recon.layers.physical_unfolding import SpectralIteration
from nlos.recon.methods import find
from nlos.recon.methods.faithful import Faithful
from nlos.recon.methods.nano import Nano
from nlos.recon.metrics import image_scores
from nlos.recon.truth_scenes import find_scenes, transient_of
from studies.paired import difference

CONDITION = "counts_p20"


def one_noise_level(network: Nano) -> None:
    """The operator is told the same middling noise level of every scan; falloff and snr still follow the estimate."""
    network.settings = network.settings.model_copy(update={"nle": False})


def without_spectral_updates(network: Nano) -> None:
    """The update of every spectral iteration is nothing; its residual block stays."""
    for module in network.modules():
        if isinstance(module, SpectralIteration):
            module.step.weight.zero_()
            assert module.step.bias is not None
            module.step.bias.zero_()


def without_the_2d_network(network: Nano) -> None:
    """0.8 x the volume under the attention."""
    for parameter in network.projection.parameters():
        if parameter.ndim == 4:
            parameter.zero_()
    head = network.projection.finish.head  # type: ignore[union-attr]
    head.bias.zero_()  # type: ignore[union-attr, operator]


def seen_once(network: Nano) -> None:
    """No mean over the mirror images of the wall."""
    network.settings = network.settings.model_copy(update={"symmetries": False})


def zeroed(*parts: str) -> Callable[[Faithful], None]:
    """All parameters of the unfolding or the projection whose names hold one of `parts` to zero."""

    def take_out(network: Faithful) -> None:
        for name, parameter in network.named_parameters():
            if any(part in name for part in parts):
                parameter.zero_()

    return take_out


def told_nothing(network: Faithful) -> None:
    """As `one_noise_level`."""
    network.settings = network.settings.model_copy(update={"nle": False})


PARTS: dict[str, Callable[[Nano], None]] = {
    "noise conditioning": one_noise_level,
    "spectral updates": without_spectral_updates,
    "2D network": without_the_2d_network,
    "mean over mirror images": seen_once,
}
PRINTED: dict[str, Callable[[Faithful], None]] = {
    "SFE": zeroed("unfolding.encoded.convolution"),
    "lifting": zeroed("unfolding.take_lifted"),
    "noise conditioning": told_nothing,
    "all iterations": zeroed(".convolution."),
    "all scales but the finest": zeroed("unfolding.prolong."),
    "all steps: the regularised inverse and the 2D network": zeroed(".convolution.", "prolong.", "aggregate."),
    "2D network": zeroed("projection.finish."),
}
OF_METHOD: dict[str, dict[str, Callable[[Any], None]]] = {"nano": PARTS, "faithful": PRINTED}


@torch.inference_mode()
def main(data: Path, method: str = "nano", condition: str = CONDITION) -> None:
    """One line a part: mean PSNR without it, and the difference to the whole with its error over scenes."""
    scenes = list(find_scenes([data], lambda _: None))
    whole: list[float] = []
    for name, take_out in {"nothing": lambda _: None, **OF_METHOD[method]}.items():
        values = []
        for scene in scenes:
            transient = transient_of(scene, condition)
            own = {"refine": False} if method == "nano" else {}  # a refinement would make up for what is taken out
            network: nn.Module = find(method).build(find(method).Settings(**own), transient.wall, transient.time)
            take_out(network)
            counts = torch.from_numpy(np.ascontiguousarray(transient.counts))[None, None]
            albedo = network(counts, torch.from_numpy(transient.exposure_s)[None])[0][0].numpy()
            values.append(image_scores(albedo, scene.intensity)["psnr"])
        whole = whole or values
        found = difference(np.array([values]), np.array([whole]))
        print(f"{condition} without {name}: {np.mean(values):.2f} dB, {found} dB", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:4])
