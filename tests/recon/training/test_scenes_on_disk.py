"""Scenes on disk: read from every layout, put on the grid whole, mixed by shares, never both learned and held out."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.load import load
from nlos.recon.errors import InvalidSettings
from nlos.recon.evaluate import evaluate
from nlos.recon.evaluation_report import table
from nlos.recon.fingerprint import fingerprint_of
from nlos.recon.training.checks import problems
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.disk_samples import file_number
from nlos.recon.training.on_grid import on_grid
from nlos.recon.training.run_folder import WEIGHTS
from nlos.recon.training.scene_files import write_scene
from nlos.recon.training.scenes_on_disk import fingerprint, read_scene, scene_files
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import read_about, save

WALL, TIME = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
GRID: dict[str, Any] = {"rows": 8, "cols": 8, "bins": 64, "bin_width_ps": 256.0}
TEXT = """\
method: unet
method_settings: {widths: [4, 8], finish_widths: [8, 8], core_points: 8}
data: {scenes: 4, degradations: 1, rows: 8, cols: 8, bins: 64, bin_width_ps: 256.0, files: "TRAIN", share: 0.5}
validation: {seed: 2, scenes: 2, degradations: 1, held_out: true, kinds: [rocks, cages]}
samples: 2
warm_up_steps: 0
cache: null
"""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mine")
    for index in range(3):
        write_scene(folder / f"{index}.h5", "stars", index, WALL, TIME)
    return folder


def settings_of(folder: Path, text: str) -> TrainSettings:
    (folder / "t.yaml").write_text(text)
    return load("train", str(folder / "t.yaml"), TrainSettings).settings


def copied(source: Path, target: Path, **changes: Any) -> Path:
    """The same scene with other datasets or attributes."""
    target.write_bytes(source.read_bytes())
    with h5py.File(target, "a") as file:
        for name, value in changes.items():
            if value is None:
                del file.attrs[name]
                continue
            if name in file.attrs or np.ndim(value) == 0:
                file.attrs[name] = value
                continue
            if name in file:
                del file[name]
            file[name] = value
    return target


def test_files_of_kinds_that_validation_draws_as_never_seen_are_refused(scenes: Path, tmp_path: Path) -> None:
    text = TEXT.replace("TRAIN", str(scenes / "*.h5"))
    assert problems(settings_of(tmp_path, text)) == []
    found = problems(settings_of(tmp_path, text.replace(", kinds: [rocks, cages]", "")))
    assert [place for place, _ in found] == [("data", "files")] * 3
    assert "0.h5: shows stars, a kind that `validation` draws as one never learned from" in found[0][1]
    assert "kinds: [signs, ladders, springs, stacks, hands, shelves, cages, rocks]" in found[0][1]
    found = problems(settings_of(tmp_path, text.replace("rocks, cages", "stars")))
    assert "learn from other scenes, or judge by files alone" in found[0][1]
    renamed = copied(scenes / "0.h5", tmp_path / "mine.h5")
    found = problems(
        settings_of(tmp_path, text.replace("rocks, cages", "stars").replace(str(scenes / "*"), str(renamed)[:-3]))
    )
    assert len(found) == 1, "by what the file holds, whatever it is called"


@pytest.mark.parametrize("share", [0.1, 0.25, 1 / 3, 0.5, 0.9, 1.0])
def test_shares_are_exact_and_lie_evenly(share: float) -> None:
    numbers = [file_number(index, share) for index in range(3000)]
    of_files = [number for number in numbers if number is not None]
    assert of_files == list(range(len(of_files)))
    assert len(of_files) == pytest.approx(3000 * share, abs=1)
    gaps = np.diff([index for index, number in enumerate(numbers) if number is not None])
    assert gaps.max() - gaps.min() <= 1


def test_made_samples_are_what_they_are_without_files_and_files_take_turns(scenes: Path, tmp_path: Path) -> None:
    plain = DatasetSettings(scenes=6, degradations=1, **GRID)
    mixed = plain.model_copy(update={"files": str(scenes / "*.h5"), "share": 0.5})
    kinds = [sample(mixed, index, tmp_path).kind for index in range(6)]
    assert kinds[1::2] == ["0.h5", "1.h5", "2.h5"]
    for index in (0, 2, 4):
        np.testing.assert_array_equal(sample(mixed, index, tmp_path).counts, sample(plain, index).counts)
    again, anew = sample(mixed, 1), sample(mixed.model_copy(update={"seed": 5}), 1)
    np.testing.assert_array_equal(sample(mixed, 1, tmp_path).counts, again.counts)  # from the cache
    np.testing.assert_array_equal(anew.intensity, again.intensity)
    assert (anew.counts != again.counts).any(), "a scene without noise is measured anew"


def test_points_and_bins_are_added_up_and_the_truth_is_averaged(scenes: Path) -> None:
    whole = read_scene(scenes / "0.h5")
    small = on_grid(whole, WallGrid(2.0, 2.0, 8, 8), TimeAxis(64, 256e-12))
    expected = whole.light.reshape(64, 2, 8, 2, 8, 2).sum(axis=(1, 3, 5))
    np.testing.assert_allclose(small.light, expected, rtol=1e-5)
    np.testing.assert_allclose(small.intensity, whole.intensity.reshape(8, 2, 8, 2).mean(axis=(1, 3)), rtol=1e-5)
    seen = small.depth_m > 0
    assert whole.depth_m[whole.depth_m > 0].min() <= small.depth_m[seen].min()
    assert small.depth_m.max() <= whole.depth_m.max()
    odd = on_grid(whole, WallGrid(2.0, 2.0, 16, 16), TimeAxis(80, 200e-12))
    np.testing.assert_allclose(odd.light.sum(axis=0), whole.light[:125].sum(axis=0), rtol=1e-4)
    middle_s = (np.arange(80) + 0.5) * 200e-12
    mean_s = (whole.light.sum(axis=(1, 2)) * (np.arange(128) + 0.5) * 128e-12).sum() / whole.light.sum()
    assert (odd.light.sum(axis=(1, 2)) * middle_s).sum() / odd.light.sum() == pytest.approx(mean_s, abs=20e-12)


def test_counts_are_taken_as_they_were_measured(scenes: Path, tmp_path: Path) -> None:
    with h5py.File(scenes / "0.h5") as file:
        counts = file["counts_p20"][...]
        held = {name: file[name][...] for name in ("gt_intensity", "gt_depth", "gt_mask")}
    exposure_s = np.full((16, 16), 2e-3)
    exposure_s[:, 3] = 0
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["histograms"], file["exposure_s"] = counts, exposure_s
        file.attrs.update({"bin_width_s": 128e-12, "wall_size_m": 2.0})
        file.update(held)
    data = DatasetSettings(files=str(tmp_path / "*.h5"), share=1.0, bins=128, bin_width_ps=128.0, rows=16, cols=16)
    got = sample(data, 0)
    np.testing.assert_array_equal(got.counts[:, :, 4:], np.moveaxis(counts, 2, 0)[:, :, 4:])
    assert (got.exposure[:, 3] == 0).all()
    assert np.isinf(got.noise_map[:, 3]).all()
    assert got.exposure[:, 4:].mean() == pytest.approx(1)
    assert got.background == pytest.approx(0.4, rel=0.2)
    np.testing.assert_array_equal(got.counts, sample(data, 5).counts)


def test_a_capture_of_ytal_is_read_with_the_truth_beside_it(scenes: Path, tmp_path: Path) -> None:
    plain = read_scene(scenes / "1.h5")
    arrays = ScanArrays(
        histograms=np.moveaxis(plain.light, 0, 2), exposure_s=np.ones((16, 16)), x_m=WALL.x_m(), y_m=WALL.y_m(),
        wall=WALL, time=TIME,
    )  # fmt: skip
    write_ytal(arrays, tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "a") as file:  # light that sets out five bins late at every point
        file["t_start"][...] = -5 * 128e-12 * SPEED_OF_LIGHT_M_PER_S
        file["H"][...] = np.roll(file["H"][...], 5, axis=0)
    with pytest.raises(ValueError, match=r"gt_intensity, gt_depth, gt_mask \[H, W\] missing; .* a\.truth\.h5"):
        read_scene(tmp_path / "a.hdf5")
    with h5py.File(scenes / "1.h5") as file, h5py.File(tmp_path / "a.truth.h5", "w") as beside:
        for name in ("gt_intensity", "gt_depth", "gt_mask"):
            beside[name] = file[name][...]
    assert scene_files(str(tmp_path / "*")) == [tmp_path / "a.hdf5"]
    seen = read_scene(tmp_path / "a.hdf5")
    np.testing.assert_allclose(seen.light[:120], plain.light[:120], atol=1e-6)
    assert not seen.counted
    assert fingerprint(tmp_path / "a.hdf5") == fingerprint(scenes / "1.h5")


def test_a_folder_of_the_lfe_set_is_a_scene_without_depths(tmp_path: Path) -> None:
    from tests.recon.training.test_lfe_set import flat

    folder = tmp_path / "0" / "m1" / "shine_0"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    (folder / "light-1-3.5-2-1.hdr").write_bytes(flat(rng.random((600 * 8, 8, 3))))
    (folder / "confocal-0-1-0.hdr").write_bytes(flat(rng.random((8, 8, 3))))
    (folder / "depth-0-1-0.hdr").write_bytes(flat(rng.random((8, 8, 3))))
    got = sample(DatasetSettings(files=str(tmp_path / "0" / "*" / "shine_*"), share=1.0, **GRID), 0, tmp_path / "kept")
    assert got.counts.shape == (64, 8, 8)
    assert got.intensity.max() == 1
    assert not got.depth_m.any()
    assert len(fingerprint(folder)) == 16


def test_the_fingerprint_is_of_what_is_shown(scenes: Path, tmp_path: Path) -> None:
    with h5py.File(scenes / "0.h5") as file:
        picture, depth_m = file["gt_intensity"][...], file["gt_depth"][...]
    changes = {"gt_intensity": 3.0 * picture[:, ::-1].astype(np.float64), "transient": np.ones((16, 16, 128))}
    changes |= {"gt_depth": depth_m[:, ::-1], "gt_mask": depth_m[:, ::-1] > 0}
    turned = copied(scenes / "0.h5", tmp_path / "other.h5", **changes)
    assert fingerprint(turned) == fingerprint(scenes / "0.h5") == fingerprint_of(picture.T, depth_m.T)
    assert len({fingerprint(path) for path in scenes.glob("*.h5")}) == 3
    assert fingerprint_of(picture, depth_m + 0.01 * (depth_m > 0)) != fingerprint_of(picture, depth_m)


def test_it_trains_and_fine_tunes_and_says_what_it_learned_from(scenes: Path, tmp_path: Path) -> None:
    pattern = str(scenes / "[01].h5")
    first = settings_of(tmp_path, TEXT.replace("TRAIN", pattern))
    assert problems(first) == []
    assert train(first, tmp_path / "a", lambda line: None)["finished"]
    about = read_about(tmp_path / "a" / WEIGHTS)
    assert about["learned_from"] == sorted(fingerprint(scenes / f"{k}.h5") for k in (0, 1))
    with pytest.raises(InvalidSettings, match=r"other settings: data\.files was"):
        train(settings_of(tmp_path, TEXT.replace("TRAIN", str(scenes / "*.h5"))), tmp_path / "a", lambda line: None)

    own = copied(scenes / "2.h5", tmp_path / "own.h5")
    bare = TEXT.replace("method_settings: {widths: [4, 8], finish_widths: [8, 8], core_points: 8}\n", "")
    tuned = bare.replace("TRAIN", str(tmp_path / "own*.h5")) + f"start_from: {tmp_path / 'a' / WEIGHTS}\n"
    tuning = settings_of(tmp_path, tuned)
    assert problems(tuning) == []
    train(tuning, tmp_path / "b", lambda line: None)
    assert len(read_about(tmp_path / "b" / WEIGHTS)["learned_from"]) == 3
    more = tuning.model_copy(update={"samples": 4})
    copied(own, tmp_path / "own2.h5", gt_intensity=np.eye(16))
    with pytest.raises(InvalidSettings, match=r"other scenes: 1 of what data\.files finds were added"):
        train(more, tmp_path / "b", lambda line: None)

    said: list[str] = []
    weights = f"mine={tmp_path / 'a' / WEIGHTS}"
    done = evaluate([scenes], [weights, "lct"], ["transient"], fixed=True, say=said.append)
    assert "**mine has learned from 1: " in table(done)
    assert [line for line in said if "learned from" in line] == [
        f"mine has learned from {k}: its figures there say nothing about other scenes" for k in (0, 1)
    ]


def test_what_is_held_out_is_refused_where_it_was_learned_from(scenes: Path, tmp_path: Path) -> None:
    """Under another name, mirrored and measured again."""
    with h5py.File(scenes / "0.h5") as file:
        changes = {name: file[name][...][::-1] for name in ("gt_intensity", "gt_depth", "gt_mask", "transient")}
    secret = copied(scenes / "0.h5", tmp_path / "quite_different.h5", **changes)
    held_out = f"validation: {{files: {tmp_path}/quite*.h5, share: 1.0, scenes: 1, degradations: 1}}"
    text = TEXT.replace("TRAIN", str(scenes / "*.h5"))
    text = text.replace(next(line for line in text.splitlines() if line.startswith("validation")), held_out)
    ((place, words),) = problems(settings_of(tmp_path, text))
    assert place == ("validation", "files")
    assert str(secret) in words
    assert str(scenes / "0.h5") in words
    text = text.replace(str(scenes / "*.h5"), str(scenes / "[12].h5"))
    assert problems(settings_of(tmp_path, text)) == []

    save(tmp_path / "w.safetensors", {}, {"method": "unet", "learned_from": [fingerprint(scenes / "0.h5")]})
    text += f"start_from: {tmp_path / 'w.safetensors'}\n"
    ((place, words),) = problems(settings_of(tmp_path, text))
    assert place == ("validation", "files")
    assert "was learned from by" in words


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "another grid": ({}, "it has 16 rows, and data has 12: only whole multiples"),
    "another wall": ({"wall_size_m": 1.0}, r"its wall is 1 x 1 m, and data has 2 x 2 m"),
    "wider bins": ({"bin_width_s": 1e-9}, "bins are 1000 ps wide, and data has 256 ps: narrower bins are not known"),
    "retroreflective": ({"falloff_exponent_authors": 2}, "is retroreflective; `data` says the opposite"),
    "not rectified": ({"rectified": False}, "time 0 is not the wall"),
    "a truth of another shape": ({"gt_depth": np.ones((4, 4))}, "the truth's arrays are of different shapes"),
    "a truth of nothing": ({"gt_intensity": np.zeros((16, 16))}, "nor 0 everywhere"),
    "light that is not finite": ({"transient": np.full((16, 16, 128), np.nan)}, "finite|not a number"),
    "a bin of unknown width": ({"bin_width_s": None}, "Put it into the file"),
    "no light": ({"transient": np.zeros((16, 16, 128))}, "not 0 everywhere"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_file_that_cannot_be_learned_from_is_named_before_the_first_step(
    fault: str, scenes: Path, tmp_path: Path
) -> None:
    changes, words = WRONG[fault]
    wrong = copied(scenes / "0.h5", tmp_path / "wrong.h5", **changes)
    text = TEXT.replace("TRAIN", str(tmp_path / "*.h5"))
    if fault == "another grid":
        text = text.replace("rows: 8", "rows: 12")
    found = problems(settings_of(tmp_path, text))
    assert [place for place, _ in found] == [("data", "files")], found
    assert str(wrong) in found[0][1]
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(found[0][1])


def test_every_held_out_file_that_is_learned_from_is_named(scenes: Path, tmp_path: Path) -> None:
    for name in ("a", "b", "c", "d", "e"):
        (tmp_path / f"{name}.h5").write_bytes((scenes / "0.h5").read_bytes())
    held_out = f"validation: {{files: {tmp_path}/*.h5, share: 1.0, scenes: 1, degradations: 1}}"
    text = TEXT.replace("TRAIN", str(scenes / "0.h5"))
    text = text.replace(next(line for line in text.splitlines() if line.startswith("validation")), held_out)
    found = problems(settings_of(tmp_path, text))
    assert [place for place, _ in found] == [("validation", "files")] * 4
    assert found[3][1] == f"2 more are learned from, too: {tmp_path / 'd.h5'}, {tmp_path / 'e.h5'}"


def test_files_that_are_not_there_or_are_no_scenes_are_named(scenes: Path, tmp_path: Path) -> None:
    found = problems(settings_of(tmp_path, TEXT.replace("TRAIN", str(tmp_path / "*.h5"))))
    assert [place for place, _ in found] == [("data", "files")]
    assert "finds nothing" in found[0][1]
    for number in range(5):
        (tmp_path / f"{number}.h5").write_bytes((scenes / "0.h5").read_bytes()[:3000])
    found = problems(settings_of(tmp_path, TEXT.replace("TRAIN", str(tmp_path / "*.h5"))))
    assert [str(tmp_path / f"{k}.h5") in words for k, (_, words) in enumerate(found[:3])] == [True] * 3
    others = f"{tmp_path / '3.h5'}, {tmp_path / '4.h5'}"
    assert found[3][1] == f"2 more cannot be used either: {others}"
