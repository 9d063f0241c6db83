"""Pictures are as one sees the wall who faces it: what lies at +x is drawn at the right, what lies at +y at the top."""

import numpy as np
import pytest

import nlos
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.font import bitmap
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface

SIDE, BINS, BIN_S, WALL_M, AWAY_M = 16, 256, 64e-12, 1.0, 2.0


@pytest.mark.parametrize("letter", ["F", "L"])
def test_an_asymmetric_letter_is_neither_mirrored_nor_upside_down(letter: str) -> None:
    """The beam goes to the right of who faces the wall for +x, up for +y; rows of the scan from the top, columns from
    the left. The letter is drawn on the wall's axes."""
    scene = SceneSettings(
        objects=(Surface(letter=letter, centre_m=(0.0, 0.0, 0.5), height_m=0.7),), direct_cps=0.0, ambient_cps=0.0
    )
    path = BeamPath(AWAY_M)
    light = SceneLight(scene, DetectorSettings(dark_cps=0.0), path, 10e6, seed=5)
    at_m = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
    histograms = np.zeros((SIDE, SIDE, BINS))
    for row, y_m in enumerate(-at_m):
        for col, x_m in enumerate(at_m):
            y_rad = np.arctan(y_m / AWAY_M)
            spot = path.spot(MirrorAngles(float(np.arctan(x_m * np.cos(y_rad) / AWAY_M)), float(y_rad)))
            assert spot is not None
            assert (spot.x_m, spot.y_m) == pytest.approx((x_m, y_m))
            way_s = 2 * spot.range_m / 299792458
            histograms[row, col] = light.photons_per_pulse(spot, BIN_S, way_s)[:BINS]
    picture = nlos.reconstruct(histograms / histograms.max(), "lct", wall=WALL_M, bin_width=BIN_S)
    drawn = truth(letter)
    agreed = {
        name: float(np.corrcoef(picture.albedo.ravel(), turned.ravel())[0, 1])
        for name, turned in {"drawn": drawn, "mirrored": drawn[:, ::-1], "upside down": drawn[::-1]}.items()
    }
    assert agreed["drawn"] > 0.7
    assert agreed["drawn"] > max(agreed["mirrored"], agreed["upside down"]) + 0.1, agreed
    assert (np.diff(picture.x_m) > 0).all()
    assert (np.diff(picture.y_m) < 0).all()


def truth(letter: str) -> np.ndarray:
    """The letter on the scan's pixels, 0.7 m tall of a wall of 1 m."""
    cells = np.array([[cell == "#" for cell in line] for line in bitmap(letter)], dtype=float)
    at_m = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
    row, col = np.floor((0.35 - (-at_m)) / 0.1).astype(int), np.floor((at_m + 0.25) / 0.1).astype(int)
    inside = ((row >= 0) & (row < 7))[:, None] & ((col >= 0) & (col < 5))[None, :]
    return np.where(inside, cells[np.clip(row, 0, 6)][:, np.clip(col, 0, 4)], 0.0)
