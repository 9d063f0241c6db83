"""Every state of a scan comes back from every format that is both written and read, and makes the picture it made."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

from nlos.__main__ import run as cli
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.loaded import load_scan

pytestmark = pytest.mark.usefixtures("one_child_reads")

ROWS, COLS, BINS, BIN_S = 6, 5, 128, 64e-12
WIDTH_M, HEIGHT_M = 1.0, 1.2
X_M = ((np.arange(COLS) + 0.5) / COLS - 0.5) * WIDTH_M
Y_M = (0.5 - (np.arange(ROWS) + 0.5) / ROWS) * HEIGHT_M
COUNTS = np.random.default_rng(8).poisson(1.5, (ROWS, COLS, BINS)).astype(np.uint16)
FREE = tuple(np.random.default_rng(9).uniform(-0.4, 0.4, (2, ROWS * COLS)))
OFFSETS = np.random.default_rng(10).uniform(3, 9, (ROWS, COLS))

GRID = {"bin_width_s": BIN_S, "wall_size_m": (WIDTH_M, HEIGHT_M)}
STATES = {
    "raw": GRID | {"rectified": 0},
    "raw, wall not known": {"bin_width_s": BIN_S, "rectified": 0},
    "rectified": GRID | {"rectified": 1},
    "rectified, cut, retroreflective": GRID | {"rectified": 1, "direct_cut_bins": 7, "falloff_exponent_authors": 2},
    "rectified, begun late": GRID | {"rectified": 1, "offset_s": 2e-9},
    "calibrated": GRID | {"rectified": 0, "time_offset_bins": OFFSETS, "response_fwhm_ps": 180.0},
    "free, raw": {"bin_width_s": BIN_S, "rectified": 0, "x_m": FREE[0], "y_m": FREE[1]},
    "free, rectified": {"bin_width_s": BIN_S, "wall_size_m": 1.0, "rectified": 1, "x_m": FREE[0], "y_m": FREE[1]},
}
FORMATS = {"npz": ".npz", "mat": ".mat", "ytal": ".hdf5", "ptu": ".ptu"}


def write(path: Path, state: str) -> Path:
    with h5py.File(path, "w") as file:
        file["histograms"] = COUNTS.reshape(-1, BINS) if state.startswith("free") else COUNTS
        for key, value in STATES[state].items():
            if isinstance(value, np.ndarray):
                file[key] = value
            else:
                file.attrs[key] = value
    return path


Command = Callable[..., str]


@pytest.fixture
def nlos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    """The command line in this process and in `tmp_path`; what it said."""
    monkeypatch.chdir(tmp_path)

    def command(*words: str) -> str:
        code = cli(list(words))
        said = capfd.readouterr()
        assert code == 0, said.err
        return said.out + said.err

    return command


CASES = [
    (state, word, imported)
    for state in STATES
    for word in FORMATS
    for imported in ((True, False) if word == "npz" else (True,))
    if not (state.startswith("free") and word in ("ytal", "ptu"))  # refused, as `test_every_exporter` says
]


@pytest.mark.parametrize(("state", "word", "imported"), CASES)
def test_a_state_comes_back(state: str, word: str, imported: bool, tmp_path: Path, nlos: Command) -> None:
    write(tmp_path / "scan.h5", state)
    source = "scan.h5"
    if imported:
        nlos("import", "scan.h5", "-o", "run.h5")
        source = "run.h5"
    target = f"there{FORMATS[word]}"
    told = nlos("export", source, "--to", word, "-o", target)
    first, stated = read_any(tmp_path / "scan.h5"), STATES[state]
    given = Given()
    if word == "ptu":  # what the format has no place for is said, with the words that bring it back
        assert f"--wall-size-m {first.held.wall.width_m:g}x{first.held.wall.height_m:g}" in told
        assert ("--rectified" in told) == bool(stated["rectified"])
        if not stated["rectified"]:
            return
        given = Given(wall_m=(WIDTH_M, HEIGHT_M), rectified=True)
    back = read_any(tmp_path / target, given)
    assert back.rectified == bool(stated["rectified"])
    assert (back.held.wall.width_m, back.held.wall.height_m) == pytest.approx(
        (first.held.wall.width_m, first.held.wall.height_m)
    )
    photons = np.asarray(back.held.counts, dtype=np.int64)
    if word == "ptu":  # has delays from time 0 on, and no place for when the first bin begins
        before = round(stated.get("offset_s", 0.0) / BIN_S)
        assert not photons[:before].any()
        photons = photons[before:]
    if back.points is None:
        assert np.array_equal(np.moveaxis(photons, 0, 2), COUNTS)
    else:
        order, found = np.lexsort(FREE), np.lexsort((back.points.x_m, back.points.y_m))
        assert np.array_equal(photons[found], COUNTS.reshape(-1, BINS)[order])
        assert np.allclose(back.points.x_m[found], FREE[0][order], atol=1e-9)
        assert np.allclose(back.points.y_m[found], FREE[1][order], atol=1e-9)
    if word == "ptu":
        return
    assert back.wall_known == ("wall_size_m" in stated or state == "free, raw")
    assert back.direct_cut_bins == stated.get("direct_cut_bins", 0)
    assert back.held.time.start_s == pytest.approx(stated.get("offset_s", 0.0))
    assert (back.falloff or 4) == stated.get("falloff_exponent_authors", 4)
    if word == "ytal":
        return  # has no place for the two below: time zero is in its paths, or not known
    if "time_offset_bins" in stated:
        assert back.time_offset_bins is not None
        assert np.allclose(back.time_offset_bins, OFFSETS, atol=1e-4)
        assert back.response is not None
        assert back.response.fwhm_s == pytest.approx(180e-12, rel=0.02)
    else:
        assert back.time_offset_bins is None
        assert back.response is None


def test_a_rectified_export_is_reconstructed_as_what_it_is(tmp_path: Path, nlos: Command) -> None:
    """A bright patch 0.4 m behind the wall's middle, its light timed from the wall: an export that forgot to say so
    would be aligned by that patch."""
    wall_m, side = 1.0, 16
    at_m = ((np.arange(side) + 0.5) / side - 0.5) * wall_m
    way_m = 2 * np.sqrt(at_m[None, :] ** 2 + at_m[:, None] ** 2 + 0.4**2)
    bins = np.round(way_m / SPEED_OF_LIGHT_M_PER_S / 32e-12 - 0.5).astype(int)
    counts = np.zeros((side, side, 256), np.uint16)
    np.put_along_axis(counts, bins[..., None], np.round(4000 * (0.8 / way_m[..., None]) ** 4).astype(np.uint16), 2)
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["histograms"] = counts
        file.attrs.update({"bin_width_s": 32e-12, "wall_size_m": wall_m})
    nlos("export", "scan.h5", "--to", "npz,mat,ytal")
    for suffix in (".npz", ".mat", ".hdf5"):
        nlos("reconstruct", f"scan{suffix}", "-o", suffix[1:])
        with h5py.File(tmp_path / suffix[1:] / "reconstruction.h5") as made:
            albedo, depth_m = made["albedo"][()], made["depth_m"][()]
        row, col = np.unravel_index(albedo.argmax(), albedo.shape)
        assert {row, col} <= {7, 8}
        assert depth_m[row, col] == pytest.approx(0.4, abs=0.02)


def test_other_readers_find_the_facts_in_the_exports(tmp_path: Path, nlos: Command) -> None:
    """NumPy's and SciPy's own."""
    write(tmp_path / "scan.h5", "rectified, cut, retroreflective")
    nlos("export", "scan.h5", "--to", "npz,mat")
    for held in (dict(np.load(tmp_path / "scan.npz")), loadmat(tmp_path / "scan.mat", squeeze_me=True)):
        assert int(held["rectified"]) == 1
        assert int(held["direct_cut_bins"]) == 7
        assert int(held["falloff_exponent_authors"]) == 2
        assert np.allclose(held["wall_size_m"], (WIDTH_M, HEIGHT_M))
        assert np.allclose(held["x_m"], X_M)
        assert np.allclose(held["y_m"], Y_M)


def test_a_free_scan_is_loaded_from_its_export_as_from_itself(tmp_path: Path, nlos: Command) -> None:
    write(tmp_path / "scan.h5", "free, rectified")
    nlos("import", "scan.h5", "-o", "run.h5")
    nlos("export", "run.h5", "--to", "npz,mat")
    first = load_scan(tmp_path / "scan.h5")
    for name in ("run.h5", "run.npz", "run.mat"):
        again = load_scan(tmp_path / name)
        assert again.rectified
        assert again.transient.wall == first.transient.wall
        assert np.array_equal(again.transient.counts, first.transient.counts)
