"""Real scenes: what is left after calibration reconstructs to the same picture as the authors' own preparation."""

from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.transient import Transient
from nlos.calibration.correct import correct

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
pytestmark = pytest.mark.skipif(not REAL.exists(), reason="../shared is not here")


def front_view(transient: Transient, falloff: int) -> np.ndarray:
    pytest.importorskip("torch")
    from nlos.recon.reconstruct import reconstruct

    settings = {"falloff": falloff, "snr": 0.8, "bin_width_ps": 16.0}
    return np.nan_to_num(reconstruct(transient, "lct", settings).albedo)


def as_the_authors_cut(transient: Transient, bins: int) -> Transient:
    counts = transient.counts.copy()
    counts[:bins] = 0
    return Transient(counts, transient.exposure_s, transient.wall, transient.time)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "scene", ["otoole_s_u", "otoole_resolution_40cm", "otoole_dots_65cm", "otoole_mannequin_directcut"]
)
def test_direct_light_is_removed_without_being_told_where_it_ends(scene: str) -> None:
    plain = read_plain(REAL / f"{scene}.h5")
    ours = front_view(correct(plain.transient, rectified=True).transient, plain.falloff)
    theirs = front_view(as_the_authors_cut(plain.transient, plain.direct_cut_bins), plain.falloff)
    assert correlation(ours, theirs) >= 0.98


def test_the_raw_scan_reconstructs_as_the_rectified_one() -> None:
    raw, rectified = read_plain(REAL / "rawscan_semisynth_s_u.h5"), read_plain(REAL / "otoole_s_u.h5")
    ours = correct(raw.transient).transient
    bins = min(2048, ours.time.bins)
    ours = Transient(ours.counts[:bins], ours.exposure_s, ours.wall, rectified.transient.time)
    theirs = as_the_authors_cut(rectified.transient, rectified.direct_cut_bins)
    assert correlation(front_view(ours, 2), front_view(theirs, 2)) >= 0.98


@pytest.mark.parametrize("scene", ["ahn_2019", "ahn_toy"])
def test_gated_scenes_are_left_as_they_are(scene: str) -> None:
    plain = read_plain(REAL / f"{scene}.h5")
    done = correct(plain.transient, rectified=True)
    assert np.array_equal(done.transient.counts, plain.transient.counts)
