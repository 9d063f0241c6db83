"""The words of the library: what a notebook needs, tried as one would."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import h5py
import numpy as np
import numpy.typing as npt
import pytest

import nlos
from nlos.__main__ import run
from nlos.acquisition.errors import PlanRefused, StorageError
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData, InvalidSettings

BIN_S = 64e-12
Histograms = npt.NDArray[np.float32]


def point_scene(rows: int = 16, cols: int = 16, depth_m: float = 0.6, bins: int = 160) -> Histograms:
    """Histograms [H, W, T] of one small diffuse object at (0.25, 0.125) m, by the law of light alone."""
    x = ((np.arange(cols) + 0.5) / cols - 0.5)[None, :]
    y = (0.5 - (np.arange(rows) + 0.5) / rows)[:, None]
    distance = np.sqrt((x - 0.25) ** 2 + (y - 0.125) ** 2 + depth_m**2)
    bin_ = np.floor(2 * distance / 299792458.0 / BIN_S).astype(int)
    counts = np.zeros((rows, cols, bins), np.float32)
    np.put_along_axis(counts, bin_[..., None], (200 / distance**4)[..., None].astype(np.float32), 2)
    return counts


def brightest(picture: nlos.Picture) -> tuple[float, float, float]:
    row, col = np.unravel_index(int(np.argmax(picture.albedo)), picture.albedo.shape)
    return float(picture.x_m[col]), float(picture.y_m[row]), float(picture.depth_m[row, col])


def test_an_array_becomes_a_picture_with_the_object_in_its_place() -> None:
    picture = nlos.reconstruct(point_scene(), wall=(1.0, 1.0), bin_width=BIN_S)
    x_m, y_m, z_m = brightest(picture)
    assert (x_m, y_m, z_m) == pytest.approx((0.25, 0.125, 0.6), abs=0.06)
    assert picture.volume is not None
    assert picture.depths_m is not None
    assert picture.volume.shape == (len(picture.depths_m), 16, 16)


def test_another_order_of_axes_gives_the_same_picture() -> None:
    counts = point_scene(rows=12)
    here = nlos.reconstruct(counts, wall=(1.0, 0.75), bin_width=BIN_S)
    there = nlos.reconstruct(np.moveaxis(counts, 2, 0), wall=(1.0, 0.75), bin_width=BIN_S, axes="TYX")
    np.testing.assert_array_equal(here.albedo, there.albedo)


def test_free_positions_show_the_object_where_it_is() -> None:
    counts = point_scene()
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16 - 0.5, 0.5 - (np.arange(16) + 0.5) / 16)
    shuffled = np.random.default_rng(3).permutation(256)
    picture = nlos.reconstruct(
        counts.reshape(256, -1)[shuffled],
        points=(x.ravel()[shuffled], y.ravel()[shuffled]),
        wall=1.0,
        bin_width=BIN_S,
    )
    assert brightest(picture) == pytest.approx((0.25, 0.125, 0.6), abs=0.07)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"histograms": np.zeros((4, 4))}, r"shape \(4, 4\).*\[H, W, T\].*points=\(x_m, y_m\)"),
        ({"histograms": np.zeros((64, 8, 8))}, "is time the first axis.*axes='TYX'"),
        ({"histograms": np.full((4, 5, 6), np.nan)}, r"histograms\[0, 0, 0\] is nan: not a finite.*120 of 120"),
        ({"histograms": np.full((4, 5, 6), -1)}, r"histograms\[0, 0, 0\] is -1: negative.*add one number"),
        ({"histograms": np.full((4, 5, 6), 1e30)}, r"histograms\[0, 0, 0\] is 1e\+30: more than anybody counts"),
        ({"histograms": np.full((4, 5, 6), 1j)}, "complex.*real numbers"),
        ({"histograms": np.zeros((4, 0, 6))}, "nothing in them"),
        ({"bin_width": None}, "bin_width is missing.*32e-12"),
        ({"bin_width": 32}, r"bin_width=32: seconds.*Did you mean bin_width=32e-12\?"),
        ({"bin_width": 0.0096}, "Divide nanoseconds by 1e9, metres of the light's way by 299792458"),
        ({"histograms": [[1.0, 2.0], [3.0]]}, "histograms: lists of unequal lengths"),
        ({"histograms": np.ones((3, 40)), "points": ([0.1, 0.5, 0.9], [0.2, 0.4, 0.9])},
         r"1 of 3 samples lie beside the wall of 1 x 1 m.*count from the wall's middle. Subtract it, or leave"),
        ({"bin_width": np.array([32e-12])}, r"bin_width=array.*: a number of seconds"),
        ({"wall": None}, r"wall is missing.*wall=\(2.0, 2.0\)"),
        ({"wall": (0, 1)}, "wall=.*metres"),
        ({"wall": 2000}, "between 0 and 100"),
        ({"wall": "1x1"}, r"wall='1x1': its side, or \(width, height\), in metres"),
        ({"wall": {"width": 1}}, "in metres between 0 and 100"),
        ({"bin_width": "32 ps"}, "bin_width='32 ps': a number of seconds"),
        ({"histograms": np.ma.masked_less(np.arange(120.0).reshape(4, 5, 6), 2)},
         r"histograms\[0, 0, 0\] is masked, other bins of that point are not \(2 of 120 values\)"),
        ({"histograms": np.ones((2, 40)), "points": (np.ma.masked_less([0.0, 1.0], 1), [0.0, 1.0])}, "is masked"),
        ({"axes": "TXX"}, "axes='TXX'"),
        ({"axes": 201}, "axes='201': the letters of 'YXT'"),
        ({"exposure": np.ones(3)}, r"exposure has shape \(3,\)"),
        ({"points": ([0.0], [0.0])}, r"\[N, T\]"),
        ({"histograms": np.ones((3, 40)), "points": ([0.0, 1.0], [0.0, 1.0])}, r"\(3,\) each is expected"),
        ({"histograms": np.ones((2, 40)), "points": ([0.0], [0.0], [0.0])}, "points holds 3 arrays"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_with_what_is_expected(given: dict[str, object], said: str) -> None:
    arguments = {"histograms": np.ones((4, 5, 6)), "wall": (1.0, 1.0), "bin_width": BIN_S} | given
    histograms = arguments.pop("histograms")
    with pytest.raises(InvalidData, match=said):
        nlos.reconstruct(histograms, **arguments)  # type: ignore[arg-type]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["<f2", ">f2", ">u2", ">f8"])
def test_counts_of_any_number_type_and_byte_order_are_the_same_counts(kind: str) -> None:
    counts = point_scene()
    told = nlos.reconstruct(counts, wall=1.0, bin_width=BIN_S)
    picture = nlos.reconstruct(counts.astype(kind), wall=1.0, bin_width=BIN_S)
    np.testing.assert_allclose(picture.albedo, told.albedo, rtol=1e-3, atol=1e-3 * float(told.albedo.max()))


def test_a_tensor_that_numpy_does_not_read_is_refused_with_what_to_do() -> None:
    import torch

    for tensor, why in (
        (torch.ones(4, 4, 64, requires_grad=True), r"Tensor is not read as a NumPy array: .*tensor\.detach\(\)"),
        (torch.ones(4, 4, 64, dtype=torch.bfloat16), "unsupported ScalarType BFloat16"),
    ):
        with pytest.raises(InvalidData, match=f"histograms: .*{why}"):
            nlos.reconstruct(tensor, wall=1.0, bin_width=BIN_S)
    with pytest.raises(TypeError, match=r"file is expected \(given: ndarray\)\. Of an array nlos\.reconstruct makes"):
        nlos.load(np.ones((4, 4, 64)))  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [int, np.float64, ">f4", "torch"])
def test_a_transient_whose_counts_were_changed_to_another_kind_is_the_same(kind: object) -> None:
    import torch

    time, wall = TimeAxis(64, BIN_S), WallGrid(1.0, 1.0, 4, 4)
    counts = np.random.default_rng(0).poisson(3.0, (64, 4, 4)).astype(np.float32)
    plain = Transient(counts, np.ones((4, 4)), wall, time)
    changed = torch.from_numpy(counts) if kind == "torch" else counts.astype(kind)  # type: ignore[call-overload]
    told, picture = nlos.reconstruct(plain), nlos.reconstruct(replace(plain, counts=changed))
    np.testing.assert_array_equal(picture.albedo, told.albedo)
    with pytest.raises(InvalidData, match="counts are masked"):
        nlos.reconstruct(replace(plain, counts=np.ma.masked_less(counts, 2)))


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (np.ones(5), r"response=array.*: auto, none, a FWHM in picoseconds, a file, or \(curve, bin width in s\)"),
        ((np.ones(5), None), r"a file, or \(curve, bin width in s\) is expected"),
        ((["a"], 2e-11), r"a file, or \(curve, bin width in s\) is expected"),
        ((np.ones(5), 20), "5 steps of 20 s; up to 100 ns in all make sense"),
    ],
)
def test_a_response_that_is_none_is_refused_in_a_sentence(said: Any, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        nlos.reconstruct(np.ones((4, 4, 64)), wall=1.0, bin_width=BIN_S, rectified=True, response=said)


def test_masked_points_were_not_measured() -> None:
    counts = point_scene()
    spoilt = counts.copy()
    spoilt[:4], spoilt[9, 3] = np.nan, 5e6
    off = np.zeros((16, 16), dtype=bool)
    off[:4] = off[9, 3] = True
    masked = np.ma.array(spoilt, mask=np.broadcast_to(off[..., None], spoilt.shape))
    told = nlos.reconstruct(np.where(off[..., None], 0, counts), wall=1.0, bin_width=BIN_S, exposure=~off)
    for histograms, more in (
        (masked, {}),
        (masked, {"exposure": np.ones((16, 16))}),
        (np.moveaxis(masked, 2, 0), {"axes": "TYX"}),
        (np.where(off[..., None], 0, counts), {"exposure": np.ma.array(np.ones((16, 16)), mask=off)}),
    ):
        picture = nlos.reconstruct(histograms, wall=1.0, bin_width=BIN_S, **more)  # type: ignore[arg-type]
        np.testing.assert_array_equal(picture.albedo, told.albedo)
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16 - 0.5, 0.5 - (np.arange(16) + 0.5) / 16)
    free = nlos.reconstruct(masked.reshape(256, -1), points=(x.ravel(), y.ravel()), wall=1.0, bin_width=BIN_S)
    assert brightest(free) == pytest.approx((0.25, 0.125, 0.6), abs=0.07)


def test_wrong_settings_are_named_with_the_nearest_right_one(tmp_path: Path) -> None:
    with pytest.raises(InvalidSettings, match="did you mean 'snr'"):
        nlos.reconstruct(point_scene(), wall=1.0, bin_width=BIN_S, snrr=1)
    path = plain_file(tmp_path)
    with pytest.raises(InvalidSettings, match="bin_width: the scan says so itself"):
        nlos.reconstruct(nlos.load(path), bin_width=BIN_S)


def plain_file(folder: Path) -> Path:
    path = folder / "plain.h5"
    with h5py.File(path, "w") as file:
        file["histograms"] = point_scene()
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = BIN_S, 1.0
    return path


def test_a_method_is_named_by_a_word_or_a_file(tmp_path: Path) -> None:
    counts = np.random.default_rng(0).poisson(1.0, (4, 4, 64))
    with pytest.raises(InvalidSettings, match="method: a name is expected"):
        nlos.reconstruct(counts, wall=1.0, bin_width=64e-12, method=nlos.methods()["lct"])  # type: ignore[arg-type]
    with pytest.raises(InvalidSettings, match=r"nowhere\.py"):
        nlos.reconstruct(counts, wall=1.0, bin_width=64e-12, method=tmp_path / "nowhere.py")


def test_a_file_loads_as_arrays_and_prints_shortly(tmp_path: Path) -> None:
    scan = nlos.load(plain_file(tmp_path))
    np.testing.assert_array_equal(scan.counts, point_scene())
    assert scan.counts.shape == (*scan.exposure_s.shape, 160)
    assert (len(scan.y_m), len(scan.x_m)) == (16, 16)
    assert scan.bin_width_s == BIN_S
    assert len(repr(scan)) < 160
    assert scan._repr_png_().startswith(b"\x89PNG")


def test_files_and_the_command_line_give_the_same_picture(tmp_path: Path) -> None:
    path = plain_file(tmp_path)
    assert run(["reconstruct", str(path), "-o", str(tmp_path / "cli")]) == 0
    with h5py.File(tmp_path / "cli" / "reconstruction.h5") as file:
        np.testing.assert_array_equal(file["albedo"][()], nlos.reconstruct(path).albedo)


def test_a_picture_shows_saves_and_becomes_an_xarray(tmp_path: Path) -> None:
    pytest.importorskip("xarray", reason="the `xarray` extra is not installed")
    picture = nlos.reconstruct(point_scene(), wall=1.0, bin_width=BIN_S)
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert len(repr(picture)) < 120
    saved = picture.save(tmp_path / "out")
    assert {path.name for path in saved} >= {"reconstruction.h5", "albedo.png", "depth.png"}
    with pytest.raises(FileExistsError, match="pass overwrite=True"):
        picture.save(tmp_path / "out")
    data = picture.to_xarray()
    assert data["volume"].dims == ("z", "y", "x")
    assert float(data["depth"].sel(x=0.25, y=0.125, method="nearest")) == pytest.approx(0.6, abs=0.06)


def test_a_bench_opens_and_a_scan_runs_from_python(tmp_path: Path) -> None:
    with nlos.open_bench("zero_latency") as bench:
        assert bench.simulated
        samples = list(nlos.scan("five_by_five", bench, output=tmp_path / "run.h5"))
    scan = nlos.load(tmp_path / "run.h5")
    assert len(samples) == int((scan.exposure_s > 0).sum())
    assert scan.counts.sum() == sum(int(sample.histogram.counts.sum()) for sample in samples)


def test_a_scan_walked_away_from_leaves_the_light_off_and_its_samples_in_the_file(tmp_path: Path) -> None:
    with nlos.open_bench("zero_latency") as bench:
        samples = nlos.scan("five_by_five", bench, output=tmp_path / "run.h5")
        next(samples)
        samples.close()
        assert bench.shutter.confirmed_closed
    with pytest.raises(StorageError, match="exists"), nlos.open_bench("zero_latency") as bench:
        nlos.scan("five_by_five", bench, output=tmp_path / "run.h5")
    assert nlos.load(tmp_path / "run.h5").exposure_s.sum() > 0


def test_a_bench_without_a_shutter_asks_first() -> None:
    with nlos.open_bench("zero_latency") as bench:
        blind = bench.settings.model_copy(
            update={"shutter": bench.settings.shutter.model_copy(update={"model": "none"})}
        )
        object.__setattr__(bench, "settings", blind)
        with pytest.raises(PlanRefused, match="no_shutter=True"):
            nlos.scan("five_by_five", bench)


def test_every_method_says_what_may_be_set() -> None:
    pytest.importorskip("torch", reason="the `recon` extra is not installed")
    for method in nlos.methods().values():
        for setting in method.settings.values():
            assert setting.type
            assert setting.what, f"{method.name}: {setting.name} has no meaning"


def test_importing_it_loads_neither_torch_nor_h5py_nor_numpy() -> None:
    program = "import sys, nlos; sys.exit(str({'torch', 'h5py', 'numpy'} & set(sys.modules)).replace('set()', '') or 0)"
    assert subprocess.run([sys.executable, "-c", program], timeout=240, check=False).returncode == 0


def test_what_a_file_does_not_say_is_said_from_python_by_the_words_for_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "mine.npy", np.moveaxis(point_scene(), 2, 0))
    said = {"wall": 1.0, "bin_width": BIN_S, "axes": "TYX", "rectified": True}
    scan = nlos.load(tmp_path / "mine.npy", **said)
    assert (scan.counts.shape, scan.wall_m, scan.bin_width_s, scan.rectified) == (
        (16, 16, 160), (1.0, 1.0), BIN_S, True,
    )  # fmt: skip
    for picture in (nlos.reconstruct(scan), nlos.reconstruct(tmp_path / "mine.npy", **said)):
        assert brightest(picture) == pytest.approx((0.25, 0.125, 0.6), abs=0.06)
    with pytest.raises(InvalidData, match="Did you mean bin_width=64e-12"):
        nlos.load(tmp_path / "mine.npy", wall=1.0, bin_width=64)
    with pytest.raises(InvalidData, match="metres between 0 and 100"):
        nlos.reconstruct(tmp_path / "mine.npy", wall=1000, bin_width=BIN_S)
    with pytest.raises(InvalidSettings, match="exposure: the scan says so itself"):
        nlos.reconstruct(tmp_path / "mine.npy", exposure=np.ones((16, 16)), **said)


@pytest.mark.parametrize("wrong", [(0.5,), 2.0, (2.0, 0.5), (-1.0, 1.0), "0.5:2", (0.1, np.nan)])
def test_a_picture_is_limited_to_depths_from_python(wrong: object) -> None:
    histograms = 0.3 * point_scene() + point_scene(depth_m=0.9)
    limited = nlos.reconstruct(histograms, wall=1.0, bin_width=BIN_S, depth_m=(0.4, 0.75))
    assert brightest(limited)[2] == pytest.approx(0.6, abs=0.06)
    assert limited.depths_m is not None
    assert 0.4 <= limited.depths_m[0] < limited.depths_m[-1] <= 0.75
    with pytest.raises(InvalidSettings, match="in metres is expected"):
        nlos.reconstruct(histograms, wall=1.0, bin_width=BIN_S, depth_m=wrong)


def test_sizes_and_places_may_be_arrays_to_a_type_checker_too() -> None:
    """They always could be when run: a recording's own `wall_size_m`, positions stacked as [2, N]."""
    hints = get_type_hints(nlos.reconstruct)
    for name in ("wall", "points", "depth_m"):
        origins = {get_origin(each) for each in get_args(hints[name])}
        assert origins & {np.ndarray, npt.NDArray}, name  # from NumPy 2.5 on the alias is a type of its own
    stacked = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 8), np.linspace(0.4, -0.4, 8))).reshape(2, -1)
    sides, depths_m = np.array([1.0, 1.0]), np.array([0.2, 1.0])
    picture = nlos.reconstruct(point_scene(8, 8).reshape(64, -1), points=stacked, wall=sides, bin_width=BIN_S,
                               depth_m=depths_m)  # fmt: skip
    assert brightest(picture)[2] == pytest.approx(0.6, abs=0.1)
