"""Samples: the same cached or not, whoever asks; and a detector whose stated noise is the true one."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.recon.training.dataset import cache_folder, sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings, measure, pile_up, respond, shift_points
from nlos.recon.training.impulse_responses import read_impulse_response
from nlos.recon.training.training_sample import TrainingSample, collate

SMALL = DatasetSettings(seed=2, scenes=4, degradations=2, rows=16, cols=16, bins=128, bin_width_ps=128.0)
PLAIN = DetectorSettings(
    noiseless=0, uniform=0, sparse=0, uneven_dwell=0, pile_up=0, calibration_residue=0, afterpulsing_most=0
)


def assert_same(a: TrainingSample, b: TrainingSample) -> None:
    for field in dataclasses.fields(a):
        np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))


def test_a_sample_is_the_same_made_cached_and_read_back_in_any_order(tmp_path: Path) -> None:
    made = [sample(SMALL, i) for i in range(len(SMALL))]
    for i in reversed(range(len(SMALL))):
        assert_same(sample(SMALL, i, tmp_path), made[i])
    for i in range(len(SMALL)):
        assert_same(sample(SMALL, i, tmp_path), made[i])
    assert len(list(cache_folder(SMALL, tmp_path).glob("*.safetensors"))) == SMALL.scenes


def test_a_longer_run_uses_the_cache_of_a_shorter_one_and_other_settings_do_not(tmp_path: Path) -> None:
    longer, other = SMALL.model_copy(update={"scenes": 9}), SMALL.model_copy(update={"seed": 3})
    assert cache_folder(longer, tmp_path) == cache_folder(SMALL, tmp_path)
    assert cache_folder(other, tmp_path) != cache_folder(SMALL, tmp_path)


def test_a_torn_cache_file_is_made_again(tmp_path: Path) -> None:
    first = sample(SMALL, 0, tmp_path)
    next(cache_folder(SMALL, tmp_path).iterdir()).write_bytes(b"torn")
    assert_same(sample(SMALL, 0, tmp_path), first)


def test_an_index_outside_is_refused() -> None:
    with pytest.raises(IndexError, match="8"):
        sample(SMALL, len(SMALL))


def test_a_batch_has_the_documented_shapes() -> None:
    batch = collate([sample(SMALL, 0), sample(SMALL, 3)])
    assert batch["counts"].shape == (2, 1, 128, 16, 16)
    assert batch["intensity"].shape == batch["exposure"].shape == (2, 16, 16)
    assert batch["normal"].shape == (2, 3, 16, 16)
    assert batch["noise_level"].shape == (2,)


TIME = TimeAxis(64, 64e-12)
PULSE = np.zeros((64, 24, 24), np.float32)
PULSE[20:24] = 1.0


@pytest.mark.parametrize("seed", range(4))
def test_the_stated_noise_and_background_are_those_of_the_counts(seed: int) -> None:
    settings = PLAIN.model_copy(update={"jitter_fwhm_most_ps": 0.0})
    got = measure(PULSE, TIME, settings, np.random.default_rng(seed))
    level = got.counts.mean(axis=(1, 2)).max() - got.background
    assert got.counts[50:].mean() == pytest.approx(got.background, abs=5 * np.sqrt(got.background / 8_064) + 1e-9)
    middle = got.counts[:, 1:-1, 1:-1].astype(float)
    spread = np.sqrt(middle.var(axis=(1, 2)).mean()) / level
    assert got.noise_level == pytest.approx(spread, rel=0.1)


def test_exposure_is_relative_and_zero_where_nothing_was_measured() -> None:
    settings = PLAIN.model_copy(update={"sparse": 1.0, "uneven_dwell": 1.0})
    got = measure(PULSE, TIME, settings, np.random.default_rng(0))
    kept = got.exposure > 0
    assert got.exposure[kept].mean() == pytest.approx(1, rel=1e-5)
    assert kept.mean() in (1 / 4, 1 / 16)
    assert not got.counts[:, ~kept].any()
    assert np.isinf(got.noise_map[~kept]).all()
    assert np.isfinite(got.noise_map[kept]).all()
    assert got.condition == "noisy+sparse"


def test_the_three_conditions_occur_as_often_as_asked() -> None:
    drawn = [measure(PULSE, TIME, DetectorSettings(), np.random.default_rng(s)).condition for s in range(150)]
    assert 5 < sum(c.startswith("noiseless") for c in drawn) < 35
    assert 2 < sum(c.startswith("uniform") for c in drawn) < 28
    assert 25 < sum(c.endswith("sparse") for c in drawn) < 70


def test_a_measured_impulse_response_keeps_light_and_centre() -> None:
    signal = np.zeros((41, 1, 1), np.float32)
    signal[20] = 1
    response = np.array([0.1, 0.2, 0.4, 0.2, 0.1])
    out = respond(signal, response)[:, 0, 0]
    np.testing.assert_allclose(out[18:23], response, atol=1e-6)
    late = respond(signal, np.array([0, 0, 0.7, 0.2, 0.1]))[:, 0, 0]
    np.testing.assert_allclose(late[20:23], [0.7, 0.2, 0.1], atol=1e-6)


def test_points_shift_by_their_own_offset() -> None:
    signal = np.zeros((9, 1, 2), np.float32)
    signal[4] = 1
    moved = shift_points(signal, np.array([[0.25, -0.5]]))
    centroid = (np.arange(9)[:, None] * moved[:, 0]).sum(0) / moved[:, 0].sum(0)
    np.testing.assert_allclose(centroid, [4.25, 3.5], atol=1e-6)


def test_pile_up_takes_late_light_and_vanishes_at_low_flux() -> None:
    rate = np.ones((50, 1, 1), np.float32)
    np.testing.assert_allclose(pile_up(rate, 1e-4), rate, rtol=1e-3)
    heavy = pile_up(rate, 0.5)[:, 0, 0]
    assert (np.diff(heavy) < 0).all()
    assert heavy.sum() / 50 == pytest.approx((1 - np.exp(-0.5)) / 0.5, rel=1e-3)


def test_a_transient_without_light_is_refused() -> None:
    with pytest.raises(ValueError, match="no light"):
        measure(PULSE * 0, TIME, PLAIN, np.random.default_rng(0))


def test_a_measured_pulse_is_rebinned_around_its_peak(tmp_path: Path) -> None:
    pulse = np.full(4000, 7.0)
    pulse[1000:1004] += [100, 1000, 400, 100]
    with h5py.File(tmp_path / "irf.h5", "w") as file:
        file["counts"] = pulse
        file.attrs["bin_width_s"] = 8e-12
    fine = read_impulse_response(tmp_path / "irf.h5", 8e-12)
    np.testing.assert_allclose(fine, np.array([0, 100, 1000, 400, 100]) / 1600, atol=1e-9)
    coarse = read_impulse_response(tmp_path / "irf.h5", 64e-12)
    assert coarse.size % 2 == 1
    assert coarse.sum() == pytest.approx(1)
    assert coarse.argmax() == coarse.size // 2
    with h5py.File(tmp_path / "flat.h5", "w") as file:
        file["counts"] = np.full(100, 3.0)
        file.attrs["bin_width_s"] = 8e-12
    with pytest.raises(ValueError, match="no pulse"):
        read_impulse_response(tmp_path / "flat.h5", 8e-12)


MEASURED = Path(__file__).parents[4] / "shared" / "data" / "tcspc"


@pytest.mark.skipif(not MEASURED.exists(), reason="needs ../shared/data/tcspc beside the repository")
@pytest.mark.parametrize(("name", "fwhm_ps"), [("irf_direct_cdt", 48), ("irf_spad_cmu", 36)])
def test_real_detectors_pulses_are_read_in_their_width(name: str, fwhm_ps: float) -> None:
    response = read_impulse_response(MEASURED / f"{name}.h5", 4e-12)
    above = np.flatnonzero(response > response.max() / 2)
    assert 4 * (above[-1] - above[0] + 1) == pytest.approx(fwhm_ps, abs=12)


@pytest.mark.parametrize("option", [{"shadows": True}, {"second_bounce": True}, {"retroreflective": True}])
def test_options_of_the_renderer_change_the_counts_and_the_cache(option: dict[str, bool], tmp_path: Path) -> None:
    plain = SMALL.model_copy(update={"kinds": ("bodies", "tubes"), "degradations": 1})
    changed = plain.model_copy(update=option)
    assert cache_folder(changed, tmp_path) != cache_folder(plain, tmp_path)
    pairs = [(sample(changed, i), sample(plain, i)) for i in range(len(plain))]
    assert not all(np.array_equal(a.counts, b.counts) for a, b in pairs)
    assert all(np.array_equal(a.intensity, b.intensity) for a, b in pairs)


def test_a_setting_at_its_default_leaves_caches_good(tmp_path: Path) -> None:
    written = DatasetSettings.model_validate({"shadows": False, "seed": 1})
    assert cache_folder(written, tmp_path) == cache_folder(DatasetSettings(), tmp_path)
