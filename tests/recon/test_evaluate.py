"""`nlos evaluate`: conditions, rows and files as its contract says, and the targets of the light-cone transform."""

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from nlos.acquisition.errors import InvalidData as NotAMeasurement
from nlos.acquisition.transient import Transient
from nlos.recon import evaluation_report
from nlos.recon.entrants import SNR_CHOICES
from nlos.recon.errors import InvalidData, InvalidSettings
from nlos.recon.evaluate import evaluate
from nlos.recon.evaluation_report import NAMES, write_evaluation
from nlos.recon.reconstruct import reconstruct
from nlos.recon.truth_scenes import read_scene as read
from nlos.recon.truth_scenes import transient_of
from nlos.recon.volume import Reconstruction

SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "synthetic"
FIELDS = {
    "scene", "method", "settings", "condition", "psnr", "ssim", "psnr_max", "ssim_max", "corr", "depth_rmse_m",
    "depth_mad_m", "depth_median_abs_m", "depth_missing", "explained", "explained_error", "seconds", "peak_rss_mb",
    "albedo_coverage", "albedo_width", "albedo_ause", "depth_coverage", "depth_width_m", "depth_ause", "seen_ece",
}  # fmt: skip


def make_scene(path: Path, seed: int = 0, square: np.ndarray | None = None) -> Path:
    """A flat square, or what is True in `square` (16, 16), at 0.6 m before a wall of 1 x 1 m, with truth."""
    edges = (np.arange(16) + 0.5) / 16 - 0.5
    if square is None:
        square = (np.abs(edges)[:, None] < 0.2) & (np.abs(edges) < 0.2)
    counts = np.zeros((16, 16, 120))
    for y, x in np.argwhere(square):
        r = np.sqrt((edges[:, None] - edges[y]) ** 2 + (edges - edges[x]) ** 2 + 0.6**2)
        k = (2 * r / 299_792_458.0 / 64e-12).astype(int)
        for row, col in np.ndindex(16, 16):
            counts[row, col, k[row, col]] += r[row, col] ** -4
    counts *= 100 / counts.max()
    with h5py.File(path, "w") as file:
        file["transient"] = counts.astype(np.float32)
        file["counts_p5"] = np.random.default_rng(seed).poisson(counts / 5 + 0.05).astype(np.uint8)
        file["gt_intensity"] = square.astype(np.float32)
        file["gt_depth"] = np.where(square, 0.6, 0).astype(np.float32)
        file["gt_mask"] = square.astype(np.uint8)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = 64e-12, 1.0
    return path


def test_every_method_at_every_condition_with_its_best_snr(tmp_path: Path) -> None:
    make_scene(tmp_path / "one.h5")
    make_scene(tmp_path / "two.h5", seed=1)
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file["histograms"] = np.ones((4, 4, 5))
    said: list[str] = []
    conditions = ("transient", "counts_p5", "counts_p5@8x8", "counts_p5@blue:64")
    done = evaluate([tmp_path], ["lct", "fk"], conditions, say=said.append)
    assert any("external.h5: no ground truth" in line for line in said)
    assert [(row.condition, row.method, row.scene) for row in done.rows] == [
        (condition, method, scene) for condition in conditions for method in ("lct", "fk") for scene in ("one", "two")
    ]
    for condition in conditions:
        snr = {row.settings["snr"] for row in done.rows if row.method == "lct" and row.condition == condition}
        assert len(snr) == 1
        assert snr < set(SNR_CHOICES)
    best = np.mean([row.psnr for row in done.rows if row.method == "lct" and row.condition == "counts_p5"])
    for snr in SNR_CHOICES:
        other = evaluate([tmp_path / "one.h5", tmp_path / "two.h5"], ["lct"], ["counts_p5"], settings={"snr": snr})
        assert np.mean([row.psnr for row in other.rows]) <= best + 1e-9
    clean = [row for row in done.rows if row.condition == "transient"]
    assert all(row.corr > 0.9 and row.depth_median_abs_m < 0.005 and row.depth_missing == 0 for row in clean)

    paths = write_evaluation(tmp_path / "out", done)
    rows = json.loads(paths[0].read_text())
    assert all(set(row) == FIELDS for row in rows)
    assert all(row["peak_rss_mb"] > 50 and row["seconds"] > 0 for row in rows)
    with paths[1].open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [float(row["psnr"]) for row in table] == [row["psnr"] for row in rows]
    assert json.loads(table[0]["settings"]) == rows[0]["settings"]
    assert "## counts_p5@8x8" in paths[2].read_text()
    with pytest.raises(FileExistsError, match="--overwrite"):
        write_evaluation(tmp_path / "out", done)


def test_a_subset_keeps_its_points_and_no_others(tmp_path: Path) -> None:
    scene = read(make_scene(tmp_path / "one.h5"))
    assert scene is not None
    whole, part = transient_of(scene, "counts_p5"), transient_of(scene, "counts_p5@4x8")
    assert part.exposure_s.sum() == 32
    kept = part.exposure_s > 0
    assert np.array_equal(part.counts[:, kept], whole.counts[:, kept])
    assert part.counts[:, ~kept].sum() == 0


def test_fixed_leaves_the_snr_to_the_method(tmp_path: Path) -> None:
    done = evaluate([make_scene(tmp_path / "one.h5")], ["lct"], ["counts_p5"], fixed=True, say=lambda line: None)
    assert done.rows[0].settings["snr"] is None


def test_what_does_not_exist_is_named(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "one.h5")
    with pytest.raises(InvalidSettings, match=r"no scene has the condition 'counts_p7'; one has: counts_p5, transient"):
        evaluate([scene], ["lct"], ["counts_p7"])
    begun: list[int] = []
    with pytest.raises(InvalidSettings, match="counts_p7"):
        evaluate([scene], ["lct"], ["transient", "counts_p7"], step=lambda done, total, at: begun.append(done))
    assert not begun, "what is misspelt is said before anything is computed"
    (tmp_path / "mine").mkdir()
    with pytest.raises(InvalidData, match=r"no scene with ground truth .* `nlos figure DIR DIR"):
        evaluate([tmp_path / "mine"], ["lct"], ["transient"])
    with pytest.raises(InvalidSettings, match="no method 'ltc'"):
        evaluate([scene], ["ltc"], ["transient"])
    with pytest.raises(InvalidData, match="does not exist"):
        evaluate([tmp_path / "none.h5"], ["lct"])
    (tmp_path / "mine.npz").write_bytes(b"PK")
    with pytest.raises(InvalidData, match="ground truth are read from HDF5 files"):
        evaluate([tmp_path / "mine.npz"], ["lct"])
    with h5py.File(scene, "a") as file:
        del file.attrs["bin_width_s"]
    with pytest.raises(NotAMeasurement, match="bin_width_s, one finite number, is missing; the file holds "):
        evaluate([scene], ["lct"], ["transient"])


def test_a_method_that_has_not_enough_memory_takes_no_other_methods_results_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(transient: Transient, method: str, *more: Any) -> Reconstruction:
        if method == "phasor":
            raise MemoryError
        return reconstruct(transient, method, *more)

    monkeypatch.setattr("nlos.recon.evaluate.reconstruct", short)
    said: list[str] = []
    done = evaluate([make_scene(tmp_path / "one.h5")], ["lct", "phasor"], ["transient"], fixed=True, say=said.append)
    assert [row.method for row in done.rows] == ["lct"]
    assert "one, transient, phasor: no result: the memory is not enough" in said


def test_two_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    """The gallery showed what was seen of one beside the truth of the other."""
    (tmp_path / "lab").mkdir()
    one, two = make_scene(tmp_path / "one.h5"), make_scene(tmp_path / "lab" / "one.h5")
    with pytest.raises(InvalidSettings, match=r"one\.h5 and .*lab/one\.h5: are two scenes of one name"):
        evaluate([one, two], ["lct"], ["transient"])


def test_the_verb_writes_its_three_files(tmp_path: Path) -> None:
    one, two = make_scene(tmp_path / "one.h5"), make_scene(tmp_path / "two.h5")
    words = ["--data", str(one), str(two), "--methods", "lct", "--conditions", "transient", "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(load_verb_as_typer(), words)
    assert result.exit_code == 0, result.output
    assert all((tmp_path / "out" / name).stat().st_size > 100 for name in NAMES)


def load_verb_as_typer():  # type: ignore[no-untyped-def]
    import typer

    from nlos.cli.evaluate import evaluate as verb

    app = typer.Typer()
    app.command()(verb)
    return app


@pytest.mark.skipif(not SHARED.exists(), reason="../shared with scenes of another renderer is not here")
@pytest.mark.soak
def test_the_light_cone_transform_reaches_its_targets() -> None:
    """On two scenes, or on all seven in the long campaign."""
    whole = os.environ.get("NLOS_SOAK") == "1"
    names = ("bear", "bear_letter", "bicycle", "bunny", "bust", "letters_su", "staircase") if whole else ("bust",)
    done = evaluate([SHARED / f"{name}.h5" for name in names], ["lct"], ["transient"], say=lambda line: None)
    assert np.mean([row.corr for row in done.rows]) >= 0.93
    for row in done.rows:
        assert row.corr >= 0.90
        assert row.depth_median_abs_m <= 0.006
        assert row.depth_missing <= 0.1
    if whole:
        targets = {"transient": 20.2, "counts_p20": 17.6, "counts_p5": 16.5, "counts_p1": 15.3}
        noisy = evaluate([SHARED / f"{name}.h5" for name in names], ["lct"], list(targets), say=lambda line: None)
        for condition, target in targets.items():
            assert np.mean([row.psnr for row in noisy.rows if row.condition == condition]) >= target


def test_what_a_file_says_of_itself_is_heeded(tmp_path: Path) -> None:
    path = make_scene(tmp_path / "one.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["falloff_exponent_authors"], file.attrs["direct_cut_bins"] = 2, 30
        file["transient"][:, :, :20] = 1000
    done = evaluate([path], ["lct"], ["transient"], fixed=True, say=print)
    assert done.rows[0].settings["falloff"] == 2
    assert done.rows[0].corr > 0.9
    given = evaluate([path], ["lct"], ["transient"], fixed=True, settings={"falloff": 4}, say=print)
    assert given.rows[0].settings["falloff"] == 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.attrs.__setitem__("bin_width_s", 0.0), "bin_width_s is 0 s"),
        (lambda file: file.attrs.__setitem__("wall_size_m", np.nan), "both sides must be above 0"),
        (lambda file: file["gt_mask"].resize((16, 15)), r"gt_mask \(16, 15\) must be the same"),
        (lambda file: file["gt_intensity"].__setitem__(..., 0), "holds no light"),
        (
            lambda file: file["gt_depth"].write_direct(file["gt_depth"][:] * 1e3),
            r"gt_depth is .* Is gt_depth in millimetres",
        ),
        (lambda file: file["gt_depth"].write_direct(-file["gt_depth"][:]), r"gt_depth is not a number above 0 at"),
        (lambda file: file["gt_depth"].write_direct(file["gt_depth"][:] * np.nan), r"gt_depth is not a number above 0"),
        (lambda file: file["transient"].resize((15, 16, 120)), "15 x 16 points, the truth is given on 16 x 16"),
        (lambda file: file["transient"].__setitem__((1, 2, 3), -1), "1 counts below 0"),
        (lambda file: file.attrs.__setitem__("rectified", 0), "one.h5: transient: is raw, and methods"),
    ],
)
def test_scenes_that_cannot_be_used_are_refused(
    tmp_path: Path, change: Callable[[h5py.File], None], message: str
) -> None:
    with h5py.File(make_scene(tmp_path / "one.h5"), "r") as file:
        held, attributes = {name: data[()] for name, data in file.items()}, dict(file.attrs)
    with h5py.File(tmp_path / "one.h5", "w") as file:
        for name, data in held.items():
            file.create_dataset(name, data=data, maxshape=data.shape)
        file.attrs.update(attributes)
        change(file)
    with pytest.raises((InvalidData, NotAMeasurement), match=message):
        evaluate([tmp_path / "one.h5"], ["lct"], ["transient"], say=print)


@pytest.mark.parametrize(
    ("turn", "named"),
    [
        (lambda truth: truth[:, ::-1], "mirrored left to right"),
        (lambda truth: truth[::-1], "upside down"),
        (lambda truth: truth.T, "with rows for columns"),
        (lambda truth: truth, ""),
    ],
)
def test_a_truth_that_lies_another_way_round_is_said(
    tmp_path: Path, turn: Callable[[np.ndarray], np.ndarray], named: str
) -> None:
    letter = np.zeros((16, 16), bool)  # an L
    letter[4:13, 5:7] = letter[11:13, 5:11] = True
    path = make_scene(tmp_path / "one.h5", square=letter)
    with h5py.File(path, "r+") as file:
        for name in ("gt_intensity", "gt_depth", "gt_mask"):
            file[name][...] = turn(file[name][:])
    notes = evaluate([path], ["lct"], ["transient"], fixed=True, say=print).notes
    assert any(f"with the truth {named}" in note for note in notes) if named else not notes


def test_a_truth_is_turned_round_as_its_histograms_are(tmp_path: Path) -> None:
    letter = np.zeros((16, 16), bool)  # an L
    letter[4:13, 5:7] = letter[11:13, 5:11] = True
    path = make_scene(tmp_path / "one.h5", square=letter)
    upright = evaluate([path], ["lct"], ["transient"], fixed=True, say=print)
    with h5py.File(path, "r+") as file:
        for name in ("transient", "gt_intensity", "gt_depth", "gt_mask"):
            file[name][...] = file[name][:][::-1, ::-1]
        file["y_m"] = (np.arange(16) - 7.5) / 16
        file.attrs["x_m"] = (7.5 - np.arange(16)) / 16
    turned = evaluate([path], ["lct"], ["transient"], fixed=True, say=print)
    assert turned.notes == []
    assert turned.rows[0].psnr == pytest.approx(upright.rows[0].psnr)
    np.testing.assert_array_equal(turned.scenes[0].intensity, letter)


def test_points_have_the_exposures_that_their_file_says(tmp_path: Path) -> None:
    path = make_scene(tmp_path / "one.h5")
    exposure_s = np.random.default_rng(1).uniform(0.5, 2, (16, 16))
    exposure_s[3, 4] = 0
    with h5py.File(path, "r+") as file:
        file["exposure_s"] = exposure_s
        file["transient"][9, 2] = np.nan
    exposure_s[9, 2] = 0
    scene = read(path)
    assert scene is not None
    transient = transient_of(scene, "transient")
    np.testing.assert_array_equal(transient.exposure_s, exposure_s)
    assert not transient.counts[:, exposure_s == 0].any()
    kept = transient_of(scene, "transient@8x8").exposure_s
    np.testing.assert_array_equal(kept, np.where(kept > 0, exposure_s, 0))


def test_a_truth_without_a_depth_where_nothing_is_scores_as_one_with_zeros(tmp_path: Path) -> None:
    path = make_scene(tmp_path / "one.h5")
    zeros = evaluate([path], ["lct"], ["transient"], fixed=True, say=print).rows[0]
    with h5py.File(path, "r+") as file:
        file["gt_depth"][...] = np.where(file["gt_mask"][:] > 0, file["gt_depth"][:], np.nan)
    nothing = evaluate([path], ["lct"], ["transient"], fixed=True, say=print).rows[0]
    assert (nothing.depth_rmse_m, nothing.corr) == (zeros.depth_rmse_m, zeros.corr)


def test_a_setting_that_no_method_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSettings, match=r"none of lct, fk has a setting 'fallof'; did you mean 'falloff'\?"):
        evaluate([make_scene(tmp_path / "one.h5")], ["lct", "fk"], ["transient"], settings={"fallof": 2}, say=print)


def test_the_gallery_names_the_ends_of_its_depth_colours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = evaluate([make_scene(tmp_path / "one.h5")], ["lct"], ["transient"], fixed=True, say=lambda line: None)
    drawn: list[Figure] = []
    monkeypatch.setattr(evaluation_report, "write_png", lambda figure, path, dots: drawn.append(figure))
    evaluation_report.gallery(done, tmp_path / "gallery.png")
    assert drawn[0].axes[0].get_ylabel() == "one\ntransient\ndepth 0.55 to 0.65 m"
