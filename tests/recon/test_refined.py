"""NANO's picture held against its light: nearer to the truth on scans nobody learned from, and with its weights."""

from pathlib import Path

import numpy as np
import torch

from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.losses import psnr
from nlos.recon.training.refinement_set import TEST, all_held, hold, scan
from nlos.recon.training.training_sample import collate


def refined(index: int, refine: bool) -> tuple[float, torch.Tensor]:
    """PSNR at the best scale, and the depth map, of one simulated scan."""
    made, data = scan(TEST, index)
    network = build(Settings(refine=refine, falloff=2 if data.retroreflective else 4), data.wall, data.time)
    assert isinstance(network, Nano)
    assert (network.refinement is not None) == refine
    batch = collate([made])
    with torch.inference_mode():
        seen = network(batch["counts"], batch["exposure"])
    return float(psnr(seen.albedo, batch["intensity"])[0]), seen.depth_m


def test_pictures_are_nearer_to_the_truth() -> None:
    gained = [refined(index, True)[0] - refined(index, False)[0] for index in (5, 16, 27, 38)]  # 32 x 32 points
    assert np.mean(gained) > 0.05, gained


def test_what_it_learns_from_is_what_nano_shows_it(tmp_path: Path) -> None:
    hold(TEST, 5, tmp_path)
    (held,) = all_held(TEST, tmp_path)
    made, _ = scan(TEST, 5)
    np.testing.assert_allclose(held.intensity.numpy(), made.intensity, atol=1e-3)
    _, depth_m = refined(5, False)
    seen = (held.found[2] > 0) & torch.isfinite(depth_m[0]) & (held.found[1] > 0)
    torch.testing.assert_close(2.0 * held.depth[seen], depth_m[0][seen], atol=1e-5, rtol=0)
    assert seen.sum() > 20
