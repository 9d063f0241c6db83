"""The simulated bench's light and our reconstruction against mitransient, a renderer that nobody here wrote."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath, Spot
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface
from nlos.recon.metrics import correlation
from nlos.recon.reconstruct import reconstruct

RENDERER = Path(__file__).parents[2] / "studies/rendered_by_mitransient.py"
WALL, TIME = WallGrid(2.0, 2.0, 32, 32), TimeAxis(512, 32e-12)
Arrays = dict[str, npt.NDArray[np.float32]]

PLAIN = (
    Surface(panel_m=(0.5, 0.4), centre_m=(-0.4, 0.3, 0.9), yaw_deg=20, albedo=0.6),
    Surface(panel_m=(0.4, 0.5), centre_m=(-0.3, -0.5, 1.0), pitch_deg=25, albedo=0.8),
    Surface(sphere_m=0.2, centre_m=(0.4, -0.2, 1.0), albedo=0.7),
)
"""As "plain" in the renderer's scenes, in the words of a bench file."""


@pytest.fixture(scope="module")
def theirs(foreign_python: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    """The scene "plain" on 32 x 32 points, by mitransient and Mitsuba."""
    python, out = foreign_python("mitsuba"), tmp_path_factory.mktemp("mitransient")
    size = ["--passes", "4", "--points", "32"]
    done = subprocess.run([python, RENDERER, out, out, "plain", *size], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    with np.load(out / "plain.npz") as file:
        return {name: file[name] for name in file.files}


def ours(surface: Surface) -> npt.NDArray[np.float64]:
    """(H, W, T) of the simulated bench, the detector all but instant, nothing but hidden light."""
    detector = DetectorSettings(jitter_fwhm_ps=1.0, tail_fraction=0.0, dark_cps=0.0, dead_time_ns=0.0)
    scene = SceneSettings(objects=(surface,), direct_cps=0.0, ambient_cps=0.0)
    light = SceneLight(scene, detector, BeamPath(2.0), 10e6, seed=1)

    def at(x_m: float, y_m: float) -> npt.NDArray[np.float64]:
        spot = Spot(x_m, y_m, 2.0, 1.0)
        return light.photons_per_pulse(spot, TIME.bin_width_s, 2 * spot.range_m / SPEED_OF_LIGHT_M_PER_S)[: TIME.bins]

    return np.array([[at(x, y) for x in WALL.x_m()] for y in WALL.y_m()])


def test_every_point_gets_the_light_that_mitransient_says(theirs: Arrays) -> None:
    other = theirs["transient"].astype(np.float64)
    each = [ours(surface).ravel() for surface in PLAIN]
    brightness, *_ = np.linalg.lstsq(np.array(each).T, other.ravel(), rcond=None)
    own = (brightness @ each).reshape(other.shape)
    by_tile = (own.sum(axis=2) / other.sum(axis=2)).reshape(4, 8, 4, 8).mean(axis=(1, 3))  # 3 % a point are drawn
    early, level, late = (np.corrcoef(np.roll(own, shift, 2).ravel(), other.ravel())[0, 1] for shift in (-1, 0, 1))
    assert np.abs(brightness / brightness.mean() - 1).max() < 0.01
    assert np.abs(by_tile - 1).max() < 0.02
    assert level > 0.98
    assert abs((early - late) / (early - 2 * level + late) / 2) < 0.05  # bins of 32 ps


@pytest.mark.parametrize(("method", "alike"), [("lct", 0.8), ("fk", 0.7), ("phasor", 0.7), ("nano", 0.9)])
def test_pictures_are_where_mitsuba_sees_things(theirs: Arrays, method: str, alike: float) -> None:
    light = np.ascontiguousarray(theirs["transient"].transpose(2, 0, 1))
    found = reconstruct(Transient(light, np.ones((WALL.rows, WALL.cols)), WALL, TIME), method)
    there = theirs["gt_mask"] > 0
    assert correlation(found.albedo, theirs["gt_intensity"]) > alike
    assert abs(np.nanmedian((found.depth_m - theirs["gt_depth"])[there])) < 0.01
    shifted = {
        (up, left): correlation(np.roll(found.albedo, (up, left), (0, 1)), theirs["gt_intensity"])
        for up in (-1, 0, 1)
        for left in (-1, 0, 1)
    }
    assert max(shifted, key=lambda shift: shifted[shift]) == (0, 0)
