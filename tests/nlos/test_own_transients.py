"""What `Scan.calibrated` gives may be cut and masked by its owner, and is reconstructed as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nlos
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.recon.errors import InvalidSettings
from tests.nlos.test_from_python import BIN_S, brightest, point_scene


@pytest.fixture(scope="module")
def transient(tmp_path_factory: pytest.TempPathFactory) -> Transient:
    """Two objects at (0.25, 0.125) m, 0.6 and 1.1 m deep, calibrated from a raw file of a lab: 2.5 ns of cable before
    direct light, dark counts under all."""
    counts = np.random.default_rng(3).poisson(1.0, (8, 8, 320)).astype(np.float32)
    counts[..., 40:200] += 5 * point_scene(8, 8)
    counts[..., 40:290] += 8 * point_scene(8, 8, 1.1, 250)
    counts[..., 39] += 1.0e5
    path: Path = tmp_path_factory.mktemp("lab") / "lab.npz"
    np.savez(path, histograms=counts.astype(np.uint32), bin_width_s=BIN_S, wall_size_m=1.0, rectified=False)
    return nlos.load(path).calibrated()


def test_it_makes_the_picture_of_its_scan(transient: Transient) -> None:
    assert transient.counts.min() < 0  # dark counts are subtracted: as plain histograms it is refused
    assert brightest(nlos.reconstruct(transient, "lct")) == pytest.approx((0.25, 0.125, 0.6), abs=0.08)


@pytest.mark.parametrize("shorter", [True, False])
def test_what_is_cut_away_is_not_seen(shorter: bool, transient: Transient) -> None:
    """The near object's light alone is dark, then the far one's is cut off with the time axis' end."""
    late = transient.time.centres_s() > 2 * 0.95 / 299_792_458
    if shorter:
        bins = int((~late).sum())
        kept = replace(transient, counts=transient.counts[:bins], time=TimeAxis(bins, BIN_S))
    else:
        kept = replace(transient, counts=np.where(late[:, None, None], transient.counts, 0))
    assert brightest(nlos.reconstruct(kept))[2] == pytest.approx(0.6 if shorter else 1.1, abs=0.06)


def test_points_that_are_masked_do_not_count(transient: Transient) -> None:
    """The left half of the wall is filled with rubbish, and is said not to have been measured."""
    bad = np.zeros(transient.exposure_s.shape, bool)
    bad[:, :3] = True
    spoiled = np.where(bad, np.roll(transient.counts, 60, axis=0) * 30, transient.counts)
    masked = replace(transient, counts=spoiled, exposure_s=np.where(bad, 0.0, transient.exposure_s))
    assert brightest(nlos.reconstruct(masked)) == pytest.approx((0.25, 0.125, 0.6), abs=0.1)


@pytest.mark.parametrize("said", [{"wall": 1.0}, {"rectified": False}, {"offsets": "file"}, {"constants": "c.h5"}])
def test_what_it_says_itself_is_not_said_again(said: dict[str, object], transient: Transient) -> None:
    with pytest.raises(InvalidSettings, match=f"{next(iter(said))}: the transient is calibrated"):
        nlos.reconstruct(transient, **said)  # type: ignore[arg-type]
