"""GNU Octave (Debian: octave) at the other end of MAT: what it saves is read, what is exported it reads."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from nlos.__main__ import run
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import FreePoints

ROWS, COLS, BINS = 3, 4, 50
COUNTS = np.random.default_rng(5).poisson(2.0, (ROWS, COLS, BINS)).astype(np.uint8)
X_M, Y_M = 0.2 * (np.arange(COLS) - 1.5), 0.2 * (1.0 - np.arange(ROWS))
WRITE = """
load('counts.mat');
base = struct('histograms', h, 'bin_width_s', 16e-12, 'wall_size_m', [0.8 0.6], 'rectified', true);
function keep(name, kind, s), save(kind, [name '.mat'], '-struct', 's'); end
keep('v6', '-v6', base); keep('v7', '-v7', base);
for kind = {'double', 'single', 'uint16', 'int32', 'int8', 'uint64'}
  s = base; s.histograms = feval(kind{1}, h); keep(kind{1}, '-v7', s);
end
s = base; s.bin_width_s = single(16e-12); s.wall_size_m = [0.8; 0.6]; s.rectified = 1; keep('columns', '-v7', s);
s = base; s.x_m = fliplr(x); s.y_m = y'; s.histograms = h(:, end:-1:1, :); keep('x_falls', '-v7', s);
s = base; [s.x_m, s.y_m] = meshgrid(x, fliplr(y)); s.histograms = h(end:-1:1, :, :); keep('y_rises', '-v7', s);
s = base; s.note = 'text'; s.list = {1, 'a'}; s.more = struct('a', 1); s.none = []; keep('more', '-v7', s);
s = base; s.histograms = permute(h, [3 1 2]); keep('TYX', '-v7', s);
s = base; s.histograms = permute(h, [3 2 1]); keep('TXY', '-v7', s);
s = base; [s.x_m, s.y_m] = meshgrid(x, y); s.x_m = s.x_m(:); s.y_m = s.y_m(:)'; s.histograms = reshape(h, [], 50);
keep('points', '-v7', s); s.histograms = double(s.histograms); keep('v4', '-v4', s);
s.histograms = sparse(s.histograms); keep('sparse', '-v7', s);
s = base; s.histograms = complex(double(h), double(h)); keep('complex', '-v7', s);
s = base; s.histograms = {h}; keep('cell', '-v7', s);
scan = base; save -v7 struct.mat scan
for kind = {'text', 'binary', 'hdf5'}, keep(kind{1}, ['-' kind{1}], base); end
"""
READ = ("v6", "v7", "double", "single", "uint16", "int32", "int8", "uint64", "columns", "x_falls", "y_rises", "more")
REFUSED = {
    "sparse": "Save full",
    "complex": "Save real",
    "cell": r"such as histograms\{1\}",
    "struct": "the file holds scan",
    "text": "save\\('-v7'",
    "binary": "save\\('-v7'",
    "hdf5": "save\\('-v7'",
}


def octave(script: str, folder: Path) -> str:
    """What it prints; it must say nothing on stderr but that it ends, as Octave 7 does at times."""
    name = shutil.which("octave-cli") or shutil.which("octave")
    if name is None:
        pytest.skip("no octave on this machine (Debian: octave)")
    done = subprocess.run([name, "-q", "--eval", script], cwd=folder, capture_output=True, text=True, timeout=120)
    told = [line for line in done.stderr.splitlines() if "while preparing to exit" not in line]
    assert not told, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("octave")
    savemat(folder / "counts.mat", {"h": COUNTS, "x": X_M, "y": Y_M})
    octave(WRITE, folder)
    return folder


@pytest.mark.parametrize("name", READ)
def test_grids_that_octave_saves_are_read_upright(saved: Path, name: str) -> None:
    back = read_any(saved / f"{name}.mat").transient
    assert np.array_equal(back.counts, COUNTS.transpose(2, 0, 1))
    assert (back.wall.width_m, back.wall.height_m) == (0.8, 0.6)
    assert back.time.bin_width_s == pytest.approx(16e-12, rel=1e-6)


@pytest.mark.parametrize("axes", ["TYX", "TXY"])
def test_other_orders_of_axes_are_put_right(saved: Path, axes: str) -> None:
    back = read_any(saved / f"{axes}.mat", Given(axes=axes)).transient
    assert np.array_equal(back.counts, COUNTS.transpose(2, 0, 1))


@pytest.mark.parametrize("name", ["points", "v4"])
def test_free_points_keep_their_places(saved: Path, name: str) -> None:
    held = read_any(saved / f"{name}.mat").held
    assert isinstance(held, FreePoints)
    col, row = np.rint(held.x_m / 0.2 + 1.5).astype(int), np.rint(1.0 - held.y_m / 0.2).astype(int)
    assert len(np.unique(row * COLS + col)) == ROWS * COLS
    assert np.array_equal(held.counts, COUNTS[row, col])


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_with_what_to_save(saved: Path, name: str) -> None:
    with pytest.raises(InvalidData, match=REFUSED[name]):
        read_any(saved / f"{name}.mat")


def test_octave_reads_what_is_exported(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(
        "wall: {width_m: 0.8, height_m: 0.6, rows: 3, cols: 4}\npattern: serpentine\ndwell_ms: 4\n"
        "histogram: {bins: 500, bin_width_ps: 32, offset_ns: 8}\n",
        "utf-8",
    )
    assert run(["scan", str(tmp_path / "scan.yaml"), "-o", str(tmp_path / "run.h5")]) == 0
    assert run(["export", str(tmp_path / "run.h5"), "--to", "mat,npz"]) == 0
    octave(
        "s = load('run.mat'); f = fopen('counts', 'w'); fwrite(f, permute(s.histograms, [3 2 1]), class(s.histograms));"
        "fclose(f); f = fopen('facts', 'w'); fwrite(f, [s.x_m(:); s.y_m(:); s.exposure_s'(:); s.bin_width_s;"
        "s.offset_s; s.wall_size_m(:)], 'double'); fclose(f);",
        tmp_path,
    )
    with np.load(tmp_path / "run.npz") as stored:
        assert stored["histograms"].sum() > 0
        assert (tmp_path / "counts").read_bytes() == stored["histograms"].tobytes()
        names = ("x_m", "y_m", "exposure_s", "bin_width_s", "offset_s", "wall_size_m")
        facts = np.concatenate([np.ravel(stored[name]) for name in names])
        assert np.array_equal(np.fromfile(tmp_path / "facts"), facts)
