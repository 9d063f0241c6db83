"""Weights describe themselves: what training wrote is all that it takes to use them, by every way to a picture."""

import errno
import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

import nlos
from nlos.__main__ import run
from nlos.acquisition.errors import StorageError
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find
from nlos.recon.training.run_folder import STATE, WEIGHTS
from nlos.recon.training.scene_files import write_scene
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.described import describe_weights, range_of, summary, use_weights
from nlos.recon.weights.files import WeightsError, read_about, read_weights, save, sha256_of

SMALL = {
    "unet": {"widths": [4, 8], "finish_widths": [8, 8], "core_points": 8},
    "lfe": {"features": 2, "renderer_width": 8},
    "nlost": {"farthest": 0.9},
    "nano": {"channels": [4, 6], "features": 2, "spectral_scales": 1, "sfe_bandwidth": 4, "symmetries": False},
    "faithful": {"channels": [4, 6], "sfe_bandwidth": 8},
}
GRID = {"rows": 16, "cols": 16, "bins": 64, "bin_width_ps": 256.0}


@pytest.fixture(scope="module", params=sorted(SMALL))
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A method, and the weights of a run of two samples in another shape than its defaults."""
    method, folder = request.param, tmp_path_factory.mktemp(request.param)
    text = {
        "method": method, "method_settings": SMALL[method], "data": {"scenes": 2, "degradations": 1, **GRID},
        "validation": {"seed": 2, "scenes": 1, "degradations": 1, "held_out": True, **GRID}, "samples": 2,
        "cache": None, "licence": "CC0-1.0",
    }  # fmt: skip
    train(TrainSettings.model_validate_json(json.dumps(text)), folder, lambda line: None)
    return method, folder / WEIGHTS


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenes") / "signs_0.h5"
    write_scene(path, "signs", 0, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    with h5py.File(path, "a") as file:
        file["histograms"] = file["counts_p20"][...]
    return path


@pytest.mark.sampled(2)
def test_weights_of_any_method_rebuild_their_own_architecture(trained: tuple[str, Path], scene: Path) -> None:
    method, path = trained
    with h5py.File(scene) as file:
        counts = np.asarray(file["counts_p20"])
    picture = nlos.reconstruct(counts, weights=path, wall=2.0, bin_width=128e-12)
    assert picture.method == method
    for key, value in SMALL[method].items():
        assert picture.settings[key] == value
    by_hand = find(method).build(
        find(method).Settings.model_validate_json(json.dumps(SMALL[method] | {"weights": str(path)})),
        WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12),
    ).eval()  # fmt: skip
    with torch.inference_mode():
        light = torch.from_numpy(np.moveaxis(counts, 2, 0).astype(np.float32))[None, None]
        albedo = by_hand(light, torch.ones(1, 16, 16)).albedo[0]
    assert np.array_equal(picture.albedo, albedo.numpy())


def test_weights_say_on_what_how_long_how_good_for_what_and_under_which_licence(trained: tuple[str, Path]) -> None:
    _, path = trained
    found = summary(str(path))
    assert found["format"] == "weights"
    assert found["trained on"]["scenes"] == 2
    assert found["for how long"].startswith("2 samples in 1 step, ")
    assert {"psnr", "depth_mad_m", "lct_psnr"} <= found["validation"].keys()
    assert found["range"]["points"] == "16 x 16, 125 mm apart on 2 m"
    assert found["range"]["bins"] == "64 of 256 ps, 16.384 ns"
    assert found["range"]["response"] == "up to 120 ps FWHM"
    assert found["licence"] == "CC0-1.0"
    assert found["architecture"].keys() >= SMALL[trained[0]].keys()
    assert summary(str(path.with_name(STATE)))["format"] == "training state"


@pytest.mark.sampled(3)
def test_the_command_line_takes_weights_alone(
    trained: tuple[str, Path],
    scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    method, path = trained
    if method != "unet":
        pytest.skip("one method is enough for what every method does alike")
    monkeypatch.chdir(tmp_path)

    def said(*words: str, code: int = 0) -> tuple[str, str]:
        assert run(list(words)) == code
        return capsys.readouterr()

    said("reconstruct", str(scene), "--weights", str(path), "-o", "out")
    with h5py.File("out/reconstruction.h5") as file:
        assert file.attrs["method"] == "unet"
    _, wrong = said("reconstruct", str(scene), "--weights", str(path), "--method", "lfe", "-o", "no", code=2)
    assert "is of the method unet, not of lfe" in wrong
    judged = ("--json", "evaluate", "--data", str(scene), "--methods", f"lct,mine={path}", "--conditions", "counts_p20")
    told = json.loads(said(*judged, "-o", "e")[0])
    rows = told["results"]
    assert [row["method"] for row in rows] == ["lct", "mine"]
    assert {str(each) for each in Path("e").iterdir()} == set(told["files"])
    assert rows[1]["settings"]["widths"] == [4, 8]
    _, twice = said("evaluate", "--data", str(scene), "--methods", f"a={path},a={path}", "-o", "e2", code=2)
    assert "named twice" in twice
    said("scan", "five_by_five", "-o", "run.h5", "--weights", str(path))
    said("replay", "run.h5", "--speed", "max", "-o", "again.h5", "--weights", str(path))
    for folder in ("run", "again"):
        with h5py.File(f"{folder}/reconstruction.h5") as file:
            assert file.attrs["method"] == "unet"
    for name, what in ((str(path), "weights"), ("run/reconstruction.h5", "reconstruction")):
        assert json.loads(said("--json", "info", name)[0])["format"] == what
    assert json.loads(said("--json", "info", "again/reconstruction.h5")[0])["scan"] == "again.h5"
    said("calibrate", "run.h5", "-o", "constants.h5")
    assert json.loads(said("--json", "info", "constants.h5")[0])["format"] == "constants"


@pytest.mark.parametrize("name", ["nano", "lfe"])
def test_weights_that_ship_are_used_as_by_their_method(name: str, scene: Path) -> None:
    with h5py.File(scene) as file:
        counts = np.asarray(file["counts_p20"])
    by_name = nlos.reconstruct(counts, name, wall=2.0, bin_width=128e-12)
    by_weights = nlos.reconstruct(counts, weights=name, wall=2.0, bin_width=128e-12)
    assert by_weights.method == name
    assert np.array_equal(by_name.albedo, by_weights.albedo)


def test_every_file_of_weights_in_the_repository_describes_itself() -> None:
    root = Path(__file__).parents[3]
    files = [*root.glob("recon/weights/*.safetensors"), *root.glob("studies/weights/*.safetensors")]
    assert len(files) >= 2
    for path in files:
        known = describe_weights(str(path))
        find(known.method).build(
            find(known.method).Settings.model_validate(known.settings),
            WallGrid(2.0, 2.0, 16, 16),
            TimeAxis(64, 256e-12),
        )


def test_weights_that_do_not_say_enough_are_refused_in_a_sentence(tmp_path: Path) -> None:
    tensors = {"a": torch.zeros(1)}
    cases = {
        "silent": ({}, "does not say which method"),
        "other": ({"method": "magic"}, "'magic', which this version does not have"),
        "noise": ({"method": "nano", "architecture": {"stage": "noise"}}, "noise level estimation alone"),
        "torn": ({"method": "unet", "architecture": {"features": "many"}}, "unet: features"),
    }
    for name, (about, why) in cases.items():
        save(tmp_path / f"{name}.safetensors", tensors, about)
        with pytest.raises(WeightsError, match=why):
            describe_weights(str(tmp_path / f"{name}.safetensors"))
    assert use_weights(tmp_path / "silent.safetensors", "unet", {"features": 4})[1]["features"] == 4
    (tmp_path / "no.safetensors").write_bytes(b"nothing")
    with pytest.raises(WeightsError, match="not a readable"):
        read_about(tmp_path / "no.safetensors")
    assert (
        range_of({"wall_width_m": 1.0, "rows": 4, "cols": 8, "bins": 2, "bin_width_ps": 4})["photons"] == "not stated"
    )


@pytest.mark.parametrize(
    ("dtype", "about", "why"),
    [("F4", "{}", "type F4, which safetensors knows"), ("F32", "[" * 100_000, "nested beyond reading")],
)
def test_weights_that_another_program_wrote_are_refused_in_a_sentence(
    dtype: str, about: str, why: str, tmp_path: Path
) -> None:
    """They were bugs of ours."""
    size = {"F4": 1, "F32": 8}[dtype]
    header = {"__metadata__": {"about": about}, "a": {"dtype": dtype, "shape": [2], "data_offsets": [0, size]}}
    text = json.dumps(header).encode()
    path = tmp_path / "theirs.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + bytes(size))
    with pytest.raises(WeightsError, match=why):
        read_weights(path)


def test_weights_that_a_disk_does_not_give_are_no_bug(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mine.safetensors"
    save(path, {"a": torch.zeros(1)}, {})

    def broken(path: Path) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "read_bytes", broken)
    with pytest.raises(StorageError, match=r"mine\.safetensors: cannot be read"):
        sha256_of(str(path))


def test_weights_of_a_method_in_a_file_need_that_file_named(tmp_path: Path) -> None:
    """They are never the reason that a file runs."""
    weights, file = tmp_path / "mine.safetensors", tmp_path / "mine.py"
    save(weights, {"x": torch.zeros(1)}, {"method": str(file), "architecture": {"least_counts": 3.0}})
    ran = tmp_path / "ran"
    example = (Path(__file__).parents[1] / "method_of_ones_own.py").read_text(encoding="utf-8")
    file.write_text(f"{example}\nopen({str(ran)!r}, 'w').close()\n", encoding="utf-8")
    for method in (None, "lct", str(tmp_path / "other.py")):
        with pytest.raises(WeightsError, match=r"the method in a file mine\.py. Name it with --method FILE"):
            use_weights(weights, method, {})
    assert not ran.exists()
    assert use_weights(weights, str(file), {})[1]["least_counts"] == 3.0
