"""What cannot be reconstructed is refused with the number and the remedy, before anything is computed."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon import memory
from nlos.recon import reconstruct as module
from nlos.recon.errors import InvalidData, InvalidSettings, ReconstructionFailed
from nlos.recon.methods import catalogue, find
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.reconstruct import rebin, reconstruct
from nlos.recon.subsets import measured_points

WALL, TIME = WallGrid(1.0, 1.0, 6, 8), TimeAxis(20, 100e-12)


@pytest.fixture
def transient() -> Transient:
    counts = np.random.default_rng(0).poisson(3, (20, 6, 8)).astype(np.float32)
    return Transient(counts, np.ones((6, 8)), WALL, TIME)


def test_counts_that_are_not_finite(transient: Transient) -> None:
    counts = transient.counts.copy()
    counts[7, 2, 3] = np.nan
    with pytest.raises(InvalidData, match=r"1 of 960 counts are not finite, the first in bin 7 of row 2, column 3"):
        reconstruct(replace(transient, counts=counts), "lct")


def test_counts_that_nobody_counts(transient: Transient) -> None:
    counts = transient.counts.copy()
    counts[7, 2, 3] = 1e30
    with pytest.raises(InvalidData, match=r"1e\+30 in bin 7 of row 2, column 3 is more than anybody counts"):
        reconstruct(replace(transient, counts=counts), "lct")


def test_no_light_at_all(transient: Transient) -> None:
    with pytest.raises(InvalidData, match="every count is 0"):
        reconstruct(replace(transient, counts=np.zeros_like(transient.counts)), "lct")
    with pytest.raises(InvalidData, match=r"add up to .* below 0"):
        reconstruct(replace(transient, counts=-transient.counts), "lct")


def test_nothing_measured(transient: Transient) -> None:
    with pytest.raises(InvalidData, match="every exposure is 0"):
        reconstruct(replace(transient, exposure_s=np.zeros((6, 8))), "lct")


def test_bins_and_walls_that_make_no_sense(transient: Transient) -> None:
    with pytest.raises(ValueError, match="bin width is 0 s"):
        TimeAxis(20, 0.0)
    with pytest.raises(ValueError, match="time axis and wall say"):
        replace(transient, wall=WallGrid(1, 1, 8, 6))
    with pytest.raises(InvalidData, match=r"100 ps cannot be added up to 150 ps.*100, 200, 400"):
        rebin(transient, 150e-12)
    assert rebin(transient, 300e-12).counts.shape == (6, 6, 8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"snrr": 1}, r"lct has no setting 'snrr'; did you mean 'snr'\?"),
        ({"snr": 0}, r"lct: snr: .*greater than 0 \(given: 0\)"),
        ({"falloff": "four"}, r"falloff: .* \(given: 'four'\)"),
        ({"conventions": "mine"}, "physical"),
        ({"tile": 0}, "tile"),
    ],
)
def test_settings_that_do_not_exist(transient: Transient, given: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidSettings, match=message):
        reconstruct(transient, "lct", given)


def test_methods_that_do_not_exist() -> None:
    with pytest.raises(InvalidSettings, match=r"no method 'ltc'; did you mean 'lct'\?"):
        find("ltc")
    lines = catalogue()
    assert {"lct", "fk", "phasor", "backprojection", "gram", "gradient_descent"} <= set(lines)
    assert all(line.endswith(".") and len(line) < 120 for line in lines.values())


def test_phasor_pulses_that_do_not_fit(transient: Transient) -> None:
    with pytest.raises(InvalidSettings, match="longer than the time axis"):
        reconstruct(transient, "phasor", {"wavelength_m": 0.5, "cycles": 8})
    for near_m in (0.1, 0.2):
        with pytest.raises(InvalidSettings, match="near must lie before far"):
            reconstruct(transient, "phasor", {"wavelength_m": 0.05, "near_m": near_m, "far_m": 0.1})
    with pytest.raises(InvalidSettings, match="far_m is 90 m, but light is looked at to"):
        reconstruct(transient, "phasor", {"wavelength_m": 0.05, "far_m": 90})


@pytest.mark.parametrize("method", ["lfe", "nlost", "unet"])
def test_networks_that_would_look_nowhere(transient: Transient, method: str) -> None:
    with pytest.raises(InvalidSettings, match="a network looks from"):
        reconstruct(transient, method, {"farthest": 0.1})
    short = replace(transient, time=TimeAxis(20, 30e-12))
    with pytest.raises(InvalidData, match="Record a longer time axis"):
        reconstruct(short, method)


@pytest.mark.parametrize("method", [name for name in catalogue() if issubclass(find(name).Settings, PhysicsSettings)])
def test_a_volume_beyond_memory(transient: Transient, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: dict[str, object] = {"wavelength_m": 0.05} if method == "phasor" else {}
    wide = WallGrid(1, 1, 60, 60)
    large = Transient(np.ones((400, 60, 60), np.float32), np.ones((60, 60)), wide, TimeAxis(400, 50e-12))
    chosen = find(method).Settings.model_validate(settings)
    needed = chosen.bytes_needed(large.wall, large.time)  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "available_bytes", lambda: int(needed * 0.9))
    remedy = {"fk": "bin_width_ps=100", "phasor": "wavelength_m=0.1"}.get(method, "tile=")
    with pytest.raises(ReconstructionFailed, match=rf"{method} of 60 x 60 points x 400 bins takes .* --set {remedy}"):
        reconstruct(large, method, settings)
    monkeypatch.setattr(module, "available_bytes", lambda: 1000)
    with pytest.raises(ReconstructionFailed, match="no setting makes that enough"):
        reconstruct(large, method, settings)


def test_nano_beyond_memory(transient: Transient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "available_bytes", lambda: 1 << 28)
    with pytest.raises(ReconstructionFailed, match=r"nano of 6 x 8 points x .* no setting makes that enough\. Crop"):
        reconstruct(transient, "nano")


def test_the_tile_that_is_named_is_enough_and_changes_nothing(
    transient: Transient, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = reconstruct(transient, "lct")
    for tile in (1, 4, 7):
        tiled = reconstruct(transient, "lct", {"tile": tile})
        assert np.abs(tiled.albedo - whole.albedo).max() <= 1e-6 * whole.albedo.max()
    assert memory.available_bytes() > 0


@pytest.mark.parametrize("subset", ["0x3", "9x2", "blue:0", "blue:49", "red:5", "3"])
def test_subsets_that_do_not_exist(subset: str) -> None:
    with pytest.raises(InvalidSettings, match=r"ask for|a subset is"):
        measured_points(subset, 6, 8)


def test_subsets_are_where_they_are_said_to_be() -> None:
    rows, cols = np.nonzero(measured_points("16x16", 64, 64))
    assert sorted(set(rows)) == [int((i + 0.5) * 4) for i in range(16)] == sorted(set(cols))
    assert measured_points("", 6, 8).all()
    blue = measured_points("blue:256", 64, 64)
    assert blue.sum() == 256
    assert np.array_equal(blue, measured_points("blue:256", 64, 64))
    row, col = np.nonzero(blue)
    apart = (row[:, None] - row) ** 2 + (col[:, None] - col) ** 2 + 10**6 * np.eye(256)
    assert apart.min() >= 8  # white noise would leave neighbours
