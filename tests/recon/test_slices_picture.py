"""slices.png: three slices on one scale, up to where something is seen, whatever the shape of wall and volume."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nlos.acquisition.wall import WallGrid
from nlos.recon.slices_picture import _shown_m, slices_picture
from nlos.recon.volume import Reconstruction, Volume


def seen_at(plane: int, wall: WallGrid, depth_m: float) -> Reconstruction:
    albedo = np.zeros((40, wall.rows, wall.cols), dtype=np.float32)
    albedo[plane, wall.rows // 2, : wall.cols // 2] = 3.0
    depths_m = np.linspace(0, depth_m, 40)
    front = albedo.max(axis=0)
    return Reconstruction(front, np.full_like(front, np.nan), wall, "lct", 1.0, volume=Volume(albedo, depths_m, wall))


def test_depths_are_shown_up_to_a_little_behind_what_is_seen() -> None:
    for plane, expected_m in ((10, 1.15 * 10 / 39), (39, 1.0)):
        volume = seen_at(plane, WallGrid(1.0, 1.0, 8, 8), 1.0).volume
        assert volume is not None
        assert _shown_m(volume) == pytest.approx(expected_m)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("width_m", "height_m", "depth_m"), [(1, 1, 1), (0.05, 0.05, 10), (8, 0.5, 0.2), (0.3, 4, 4)])
def test_walls_and_volumes_of_any_shape_fit(tmp_path: Path, width_m: float, height_m: float, depth_m: float) -> None:
    slices_picture(seen_at(39, WallGrid(width_m, height_m, 8, 8), depth_m), tmp_path / "slices.png")
    with Image.open(tmp_path / "slices.png") as picture:
        assert max(picture.size) < 2000
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    grey = (np.ptp(pixels, axis=2) == 0) & (pixels[..., 0] < 8)
    assert grey.mean() > 0.02  # slices, not empty corners
    assert (np.abs(pixels - (0x56, 0xB4, 0xE9)).sum(axis=2) < 60).any()
