"""What the instrument makes of an instant: where it is taken from, in which order, and what is refused."""

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

import nlos as library
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.response import Response, as_json, from_json, full_width_steps, gaussian, measured
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.array_scan import scan_from_arrays
from nlos.calibration.constants import BenchConstants, Quantity, save
from nlos.calibration.impulse_response import from_histogram
from nlos.chain import calibrate_scan, reconstruct_file
from nlos.loaded import load_scan
from nlos.recipe import Recipe
from nlos.recon.errors import InvalidSettings
from nlos.recon.light_cone_method import LightConeMethod
from nlos.recon.methods import find
from nlos.recon.metrics import image_scores
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.dataset import DatasetSettings
from nlos.recon.training.detector import respond
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Surfels, front_view, make_scene, surfels
from nlos.recon.truth_scenes import read_scene, transient_of
from nlos.recon.volume import Reconstruction
from nlos.report import page
from nlos.response import known_response, lateral_m, response_wanted, say_response
from nlos.results_folder import ResultsFolder
from tests.scan_texts import COARSE_TO_FINE

pytestmark = pytest.mark.usefixtures("one_child_reads")

BIN_S = 64e-12

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


def curve(fwhm_ps: float, step_ps: float = 8.0) -> np.ndarray:
    t = np.arange(-300, 301) * step_ps
    return np.exp2(-4 * (t / fwhm_ps) ** 2)


def bench_constants() -> BenchConstants:
    """With a response of 90 ps."""
    response = from_histogram(curve(90), 8e-12)
    return BenchConstants(
        {}, "2026-01-01T00:00:00+00:00", ("a.h5",), BIN_S, response=response, dark_hz=Quantity(1.0, 0.1)
    )  # fmt: skip


def plain_file(path: Path, **said: object) -> Path:
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file["histograms"] = rng.poisson(2.0, (6, 6, 64)).astype(np.uint16)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = BIN_S, 1.0
        for name, value in said.items():
            if np.ndim(value):
                file[name] = value
            else:
                file.attrs[name] = value
    return path


@pytest.mark.parametrize(
    ("shares", "steps"), [([1.0], 1), ([3.0, 3.0], 2), ([0.0, 1.0, 2.0, 1.0, 0.0], 2), ([0.0, 1.0, 4.0, 3.0, 0.0], 2)]
)
def test_widths_lie_between_steps(shares: list[float], steps: float) -> None:
    assert full_width_steps(np.array(shares)) == pytest.approx(steps)


def test_a_response_keeps_its_width_in_bins_of_any_width() -> None:
    response = gaussian(300e-12, "here")
    assert response.fwhm_s == pytest.approx(300e-12, rel=2e-3)
    for width_s in (4e-12, 32e-12, 64e-12, 200e-12):
        taps = response.taps(width_s)
        place = (np.arange(len(taps)) - len(taps) // 2) * width_s
        assert len(taps) % 2 == 1
        assert taps.sum() == pytest.approx(1)
        assert abs(taps @ place) < 1e-15
        sigma_s = np.sqrt(taps @ place**2 - width_s**2 / 12)
        assert 2.3548 * sigma_s == pytest.approx(300e-12, rel=0.02)
    assert len(gaussian(1e-12, "fast").taps(64e-12)) <= 3


def test_a_lopsided_response_is_timed_by_its_maximum() -> None:
    response = measured([0.0, 1.0, 4.0, 2.0, 1.0], 50e-12, "here")
    assert np.allclose(response.taps(50e-12), np.array([0, 1, 4, 2, 1]) / 8)
    assert from_json(as_json(response)) is not None
    assert np.array_equal(from_json(as_json(response)).taps(50e-12), response.taps(50e-12))  # type: ignore[union-attr]
    assert from_json(None) is None


@pytest.mark.parametrize("stored", [3, {"shares": "x"}, {"shares": [1.0], "step_s": -1.0, "zero": 0.0, "source": "s"}])
def test_a_recording_whose_response_was_tampered_with_is_refused(stored: object) -> None:
    with pytest.raises(InvalidData):
        from_json(stored)


def test_the_sources_go_before_each_other(tmp_path: Path) -> None:
    scan = load_scan(plain_file(tmp_path / "said.h5", response_fwhm_ps=250.0))
    own = from_histogram(curve(120), 8e-12)
    constants = BenchConstants(
        {}, "2026-01-01T00:00:00+00:00", ("a.h5",), BIN_S, response=from_histogram(curve(90), 8e-12)
    )

    def taken(scan: object, constants: object, own: object) -> tuple[int, str]:
        found = known_response(scan, constants, own)  # type: ignore[arg-type]
        assert found is not None
        return round(found.fwhm_s * 1e12), found.source

    assert taken(scan, constants, own) == (90, "the bench's constants of 2026-01-01T00:00:00+00:00")
    assert taken(scan, None, own) == (250, f"{tmp_path / 'said.h5'}: response_fwhm_ps")
    without = replace(scan, response=None)
    assert taken(without, None, own)[1] == "the scan's own direct peak"
    assert taken(without, None, own)[0] == pytest.approx(120, abs=9)
    assert known_response(without, None, None) is None


def test_the_direct_light_that_a_file_still_holds_tells_its_response() -> None:
    histograms = np.full((5, 5, 128), 1.0)
    pulse = curve(200, BIN_S * 1e12)[290:312] * 400
    histograms[:, :, : len(pulse)] += pulse
    histograms[:, :, 60:70] += 5
    scan = scan_from_arrays(histograms, bin_width=BIN_S, wall=1.0)
    response = calibrate_scan(replace(scan, direct_cut_bins=30)).response
    assert response is not None
    assert response.fwhm_s == pytest.approx(200e-12, rel=0.1)
    dark = np.where(np.arange(128) < 30, 0.0, histograms)
    assert (
        calibrate_scan(replace(scan_from_arrays(dark, bin_width=BIN_S, wall=1.0), direct_cut_bins=30)).response is None
    )


def test_files_state_their_response_by_width_or_by_curve(nlos: Nlos, tmp_path: Path) -> None:
    path = plain_file(tmp_path / "c.h5", response=curve(400, 20), response_bin_width_s=20e-12, response_fwhm_ps=100.0)
    found = load_scan(path).response
    assert found is not None
    assert found.fwhm_s == pytest.approx(400e-12, rel=0.01)
    with np.load(_as_npz(path, tmp_path / "c.npz")) as arrays:
        assert "response_fwhm_ps" in arrays
    again = load_scan(tmp_path / "c.npz").response
    assert again is not None
    assert again.fwhm_s == pytest.approx(150e-12, rel=0.01)
    assert nlos("import", str(path), "-o", str(tmp_path / "run.h5")).returncode == 0
    kept = load_scan(tmp_path / "run.h5").response
    assert kept is not None
    assert kept.fwhm_s == pytest.approx(found.fwhm_s)


def _as_npz(path: Path, target: Path) -> Path:
    with h5py.File(path) as file:
        np.savez(
            target, histograms=file["histograms"][...], bin_width_s=BIN_S, x_m=np.linspace(-0.4, 0.4, 6),
            y_m=np.linspace(-0.4, 0.4, 6), rectified=1, response_fwhm_ps=150.0,
        )  # fmt: skip
    return target


@pytest.mark.parametrize(
    ("said", "code", "words"),
    [
        ("-300", 2, "1 to 25000"),
        ("nan", 2, "picoseconds"),
        ("0", 2, "picoseconds"),
        ("3e-10", 2, "Did you mean 300?"),
        ("there_is_none.h5", 2, "no such file"),
        ("said.h5", 7, "said.h5"),
    ],
)
def test_what_is_no_response_is_refused_before_anything_is_made(
    nlos: Nlos, tmp_path: Path, said: str, code: int, words: str
) -> None:
    plain_file(tmp_path / "said.h5")
    done = nlos("reconstruct", "said.h5", "-o", "out", f"--response={said}")
    assert done.returncode == code
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("wrong", [{"response_fwhm_ps": -3.0}, {"response_fwhm_ps": 1e9}, {"response": [1.0, 2.0]}])
def test_a_file_that_states_nonsense_is_refused(tmp_path: Path, wrong: dict[str, object]) -> None:
    plain_file(tmp_path / "wrong.h5", **wrong)
    with pytest.raises(InvalidData, match=r"wrong\.h5"):
        load_scan(tmp_path / "wrong.h5")


def test_python_knows_the_same_words(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "a.h5", response_fwhm_ps=150.0)
    assert library.reconstruct(path).response.startswith("150 ps FWHM")
    assert library.reconstruct(path, response="none").response == "none known"
    assert library.reconstruct(path, response=300).response == "300 ps FWHM, a Gaussian, as given"
    assert library.reconstruct(path, response=(curve(80), 8e-12)).response.startswith("80 ps FWHM")
    assert library.reconstruct(path, "backprojection").response.endswith("backprojection does not use it")
    with pytest.raises(InvalidSettings, match="Did you mean 300"):
        library.reconstruct(path, response=300e-12)
    with pytest.raises(InvalidSettings, match="auto, none"):
        response_wanted([1, 2, 3])


def test_the_result_says_what_was_taken(nlos: Nlos, tmp_path: Path) -> None:
    save(bench_constants(), tmp_path / "bench.h5")
    path = plain_file(tmp_path / "a.h5")
    for said, fwhm_ps in (("none", None), ("400", 400), (str(tmp_path / "bench.h5"), 90)):
        folder = tmp_path / f"out{fwhm_ps}"
        reconstruct_file(path, Recipe("lct", response=response_wanted(said)), ResultsFolder(folder))
        with h5py.File(folder / "reconstruction.h5") as file:
            assert ("response_fwhm_ps" in file.attrs) == (fwhm_ps is not None)
            if fwhm_ps is not None:
                assert file.attrs["response_fwhm_ps"] == pytest.approx(fwhm_ps, rel=0.1)
                assert str(file.attrs["response"]).startswith(f"{file.attrs['response_fwhm_ps']:.0f} ps")
    done = nlos("reconstruct", str(path), "-o", "out", "--response", "2000")
    assert "response: 2000 ps FWHM, a Gaussian, as given" in done.stdout
    assert "response: " not in done.stderr  # it is said once
    assert "is slow for this wall" in done.stderr


def test_a_scan_says_of_its_picture_that_the_response_it_was_told_is_wrong(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(COARSE_TO_FINE.replace("{kind: coarse_to_fine, batch: 8}", "serpentine"))
    done = nlos("scan", "s.yaml", "-o", "run.h5", "--reconstruct", "lct", "--response", "4000", "--json")
    assert "(without the response (a Gaussian, as given) it explains" in done.stderr
    assert "try --response none" in json.loads(done.stdout)["reconstruction"]["explained_note"]


def test_a_report_shows_the_picture_that_reconstruct_makes(
    nlos: Nlos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a raw scan, whose own direct light tells the response."""
    scan = "wall: {width_m: 1, height_m: 1, rows: 8, cols: 8}\npattern: raster\ndwell_ms: 20\n"
    (tmp_path / "s.yaml").write_text(f"{scan}histogram: {{bins: 512, bin_width_ps: 32, offset_ns: 10}}\n")
    assert nlos("scan", "s.yaml", "-o", "run.h5").returncode == 0
    shown: list[Reconstruction] = []

    def seen(*scan: Any, **said: Any) -> Reconstruction:
        shown.append(reconstruct(*scan, **said))
        return shown[-1]

    monkeypatch.setattr(page, "reconstruct", seen)
    page.write_report([tmp_path / "run.h5"], tmp_path / "r.html", ["lct"])
    made = library.reconstruct(library.load(tmp_path / "run.h5"), "lct")
    assert "own direct peak" in made.response
    assert library.Picture(shown[0]).response == made.response
    assert np.array_equal(shown[0].albedo, made.albedo)


def test_only_a_response_too_slow_for_the_wall_is_called_slow(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    transient = calibrate_scan(load_scan(plain_file(tmp_path / "a.h5")))
    say_response(replace(transient, response=gaussian(40e-12, "here")))
    assert "is slow for this wall" not in caplog.text
    say_response(replace(transient, response=gaussian(2000e-12, "here")))
    assert "is slow for this wall" in caplog.text


@pytest.mark.parametrize("size_m", [(2.0, 2.0), (0.01, 2.0)])
def test_resolution_is_the_published_one(size_m: tuple[float, float]) -> None:
    wall, time = WallGrid(*size_m, 4, 4), TimeAxis(256, BIN_S)
    counts = np.zeros((256, 4, 4), np.float32)
    at = round(2 * 1.0 / 299792458 / BIN_S)
    counts[at] = 1
    transient = Transient(counts, np.ones((4, 4)), wall, time)
    assert lateral_m(transient, 100e-12) == pytest.approx(299792458 * 100e-12 * np.hypot(1, 1) / 2, rel=0.02)


@pytest.fixture(scope="module")
def slow_scene() -> tuple[Transient, Transient, np.ndarray]:
    """A made scene without a response, the same through 300 ps (Poisson noise in both), and its true picture."""
    data = DatasetSettings(seed=11, wall_width_m=1.0, rows=32, cols=32, bins=128, bin_width_ps=64.0)
    scene = make_scene(11, 1, data.wall, kinds=("letters",))
    clean = render(surfels(scene, np.random.default_rng(0)), data.wall, data.time).numpy()
    response = gaussian(300e-12, "known")
    spread = respond(clean, response.taps(data.time.bin_width_s))

    def scan(transient: np.ndarray) -> Transient:
        level = 40 / spread.max(axis=0).mean()
        counts = np.random.default_rng(1).poisson(level * transient + 0.2).astype(np.float32)
        return Transient(counts, np.ones((32, 32)), data.wall, data.time)

    return scan(clean), scan(spread), front_view(scene, data.wall).intensity


@pytest.mark.parametrize("method", ["lct", "gram"])
def test_told_beats_untold_where_the_detector_is_slow(
    method: str, slow_scene: tuple[Transient, Transient, np.ndarray]
) -> None:
    _, slow, truth = slow_scene
    told = replace(slow, response=gaussian(300e-12, "known"))
    untold_db, told_db = (at_best(scan, method, truth) for scan in (slow, told))
    assert told_db > untold_db + 0.3
    for by in (0.8, 1.2):
        wrong = replace(slow, response=gaussian(300e-12 * by, "wrong"))
        assert at_best(wrong, method, truth) > told_db - 0.5


@pytest.mark.parametrize("method", ["lct", "gram"])
def test_a_slow_response_does_not_darken_what_lies_deeper(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over t^2 a response is wider the later: two equal boards at 0.5 and 1.1 m are as bright as without it."""
    wall, time = WallGrid(1.5, 1.5, 32, 32), TimeAxis(192, BIN_S)
    fine = WallGrid(1.5, 1.5, 128, 128)

    def boards(grid: WallGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        x, y = (each.ravel() for each in np.meshgrid(grid.x_m(), grid.y_m()))
        return x, y, (np.abs(x + 0.4) < 0.2) & (np.abs(y) < 0.25), (np.abs(x - 0.4) < 0.2) & (np.abs(y) < 0.25)

    x, y, near, far = boards(fine)
    place = np.stack([x, y, np.where(near, 0.5, 1.1)], axis=1)[near | far].astype(np.float32)
    normal = np.tile(np.array([0, 0, -1], np.float32), (len(place), 1))
    clean = render(Surfels(place, normal, np.ones(len(place), np.float32)), wall, time).numpy()
    response = gaussian(600e-12, "known")
    spread = respond(clean, response.taps(time.bin_width_s))
    *_, near, far = boards(wall)

    inverse = find(method).build(find(method).Settings.model_validate({"snr": 1.0}), wall, time)
    assert isinstance(inverse, LightConeMethod)

    def deeper_over_nearer(light: np.ndarray, taps: torch.Tensor | None) -> float:
        signal = inverse.falloff(torch.from_numpy(light).float()[None, None])
        volume = inverse.resample.adjoint(inverse.solved(signal, 1.0, taps))
        picture = volume.amax(dim=(0, 1, 2)).ravel().numpy()
        return float(picture[far].mean() / picture[near].mean())

    quick = deeper_over_nearer(clean, None)
    told = deeper_over_nearer(spread, torch.from_numpy(response.taps(time.bin_width_s))[None])
    assert told == pytest.approx(quick, rel=0.25)
    monkeypatch.setattr("nlos.recon.light_cone_method.plane_brightness", lambda *_: np.ones(4))
    uneven = deeper_over_nearer(spread, torch.from_numpy(response.taps(time.bin_width_s))[None])
    assert uneven < 0.7 * told


@pytest.mark.parametrize("method", ["fk", "phasor"])
@pytest.mark.parametrize("kept", [1, 3])  # of the points, one in so many at random
def test_a_wave_told_of_a_slow_detector_sees_more(method: str, kept: int) -> None:
    data = DatasetSettings(rows=32, cols=32, bins=128, bin_width_ps=96.0)
    better_db = []
    for number in range(3):
        scene = make_scene(12, number, data.wall)
        clean = render(surfels(scene, np.random.default_rng(0)), data.wall, data.time).numpy()
        response = gaussian(700e-12, "known")
        spread = respond(clean, response.taps(data.time.bin_width_s))
        counts = np.random.default_rng(1).poisson(20 / spread.max(axis=0).mean() * spread + 0.1).astype(np.float32)
        exposure = (np.random.default_rng(2).random((32, 32)) < 1 / kept).astype(float)
        slow = Transient(counts * exposure.astype(np.float32), exposure, data.wall, data.time)
        truth = front_view(scene, data.wall).intensity
        untold, told, wrong = (
            reconstruct(replace(slow, response=known), method, explain=False).albedo
            for known in (None, response, gaussian(840e-12, "a fifth wider"))
        )
        assert image_scores(wrong, truth)["psnr"] > image_scores(told, truth)["psnr"] - 1.5
        better_db.append(image_scores(told, truth)["psnr"] - image_scores(untold, truth)["psnr"])
    assert np.mean(better_db) > 0.5


def at_best(scan: Transient, method: str, truth: np.ndarray) -> float:
    """PSNR at the best of three snr."""
    return max(image_scores(reconstruct(scan, method, {"snr": snr}).albedo, truth)["psnr"] for snr in (10.0, 1.0, 0.1))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", ["lct", "gram", "gradient_descent", "fk", "phasor", "nano"])
def test_an_instant_response_changes_nothing(method: str, slow_scene: tuple[Transient, Transient, np.ndarray]) -> None:
    quick, _, _ = slow_scene
    none = Response(np.ones(1), quick.time.bin_width_s, 0.0, "an instant")
    told, untold = reconstruct(replace(quick, response=none), method), reconstruct(quick, method)
    assert np.array_equal(told.albedo, untold.albedo)
    assert np.array_equal(told.depth_m, untold.depth_m, equal_nan=True)
    assert told.response_used or method == "nano"
    assert not untold.response_used


def test_the_phasor_fields_approximation_is_not_told(slow_scene: tuple[Transient, Transient, np.ndarray]) -> None:
    _, slow, _ = slow_scene
    variant = {"variant": "light_cone"}
    told = reconstruct(replace(slow, response=gaussian(300e-12, "known")), "phasor", variant, explain=False)
    assert not told.response_used
    assert np.array_equal(told.albedo, reconstruct(slow, "phasor", variant, explain=False).albedo)


def test_weights_that_were_never_told_a_response_are_not_told_one(tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    from nlos.recon.methods import nano
    from nlos.recon.weights.files import find_weights

    held = load_file(find_weights("nano"))
    older = {name: tensor for name, tensor in held.items() if not name.startswith(nano.TOLD)}
    save_file(older, tmp_path / "older.safetensors")
    wall, time = WallGrid(1.0, 1.0, 16, 16), TimeAxis(64, 64e-12)
    assert not nano.build(nano.Settings(weights=str(tmp_path / "older.safetensors")), wall, time).takes_response
    assert nano.build(nano.Settings(weights=None), wall, time).takes_response


SCENE = Path(__file__).parents[2].parent / "shared" / "data" / "synthetic" / "bear_letter.h5"


@pytest.mark.skipif(not SCENE.is_file(), reason="../shared/data is absent")
def test_nano_told_beats_untold_at_600_ps() -> None:
    scene = read_scene(SCENE)
    assert scene is not None
    slow = transient_of(scene, "counts_p20~600ps")
    assert slow.response is not None
    pictures = [
        reconstruct(scan, "nano", {"symmetries": False}, explain=False).albedo
        for scan in (replace(slow, response=None), slow, replace(slow, response=gaussian(480e-12, "a fifth off")))
    ]
    untold_db, told_db, wrong_db = (image_scores(picture, scene.intensity)["psnr"] for picture in pictures)
    assert told_db > untold_db + 0.5
    assert wrong_db > told_db - 0.5
