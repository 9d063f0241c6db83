"""Instruments' own files - PTU, SDT, Photon-HDF5 - make pictures at their depths, on a wall that direct times tell."""

import json
from pathlib import Path

import h5py
import numpy as np
import ptufile
import pytest

from nlos.acquisition.importers.formats import read_any
from tests.acquisition.importers.photon_files import write_photons
from tests.acquisition.importers.sdt_files import write_sdt

POINTS, BINS = 16, 1024
BIN_S = 5e-8 / BINS  # of an SDT file's time-to-amplitude converter
WIDTH_M, DEPTH_M, SCANNER_M, DELAY_S = 0.9, 0.5, (0.1, -0.05, 0.8), 4e-9
LIGHT_M_PER_S = 299_792_458.0
LCT_M = 0.03
"""Its depths from 256 points with a response of 141 ps."""
FORMS = ("ptu", "sdt", "photons")


def drawn() -> np.ndarray:
    """Photons (H, W, T) of a scanner in front of a wall, and of a plate of 0.3 x 0.3 m behind the corner."""
    places = (np.arange(POINTS) + 0.5) / POINTS * WIDTH_M - WIDTH_M / 2
    x, y = np.meshgrid(places, -places)
    reach = np.sqrt((x - SCANNER_M[0]) ** 2 + (y - SCANNER_M[1]) ** 2 + SCANNER_M[2] ** 2)
    time_s = (np.arange(BINS) + 0.5) * BIN_S

    def pulse(metres: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * ((time_s - DELAY_S - metres[..., None] / LIGHT_M_PER_S) / 60e-12) ** 2)

    rates = 2000 * pulse(2 * reach) + 0.02
    for u, v in np.random.default_rng(1).uniform(-0.15, 0.15, (200, 2)):
        away = np.sqrt((x - u) ** 2 + (y - v) ** 2 + DEPTH_M**2)
        rates += 0.9 * (DEPTH_M / away[..., None]) ** 4 * pulse(2 * reach + 2 * away)
    return np.random.default_rng(0).poisson(rates).astype(np.uint16)


def write(folder: Path, form: str, counts: np.ndarray) -> Path:
    match form:
        case "ptu":
            image = counts.reshape(1, *counts.shape[:2], 1, BINS)
            ptufile.imwrite(folder / "scan.ptu", image, 1e-7, BIN_S, 40_000 * 1e-7,
                            record_type=ptufile.PtuRecordType.GenericT3)  # fmt: skip
            return folder / "scan.ptu"
        case "sdt":
            return write_sdt(folder / "scan.sdt", [counts], said={"tac_g": 1})
        case _:
            return write_photons(folder / "scan.h5", counts, BIN_S)


@pytest.fixture(scope="module")
def counts() -> np.ndarray:
    return drawn()


def seen(folder: Path) -> tuple[float, float]:
    """Of a result: the wall's width, and the depth where it is brightest."""
    with h5py.File(folder / "reconstruction.h5") as file:
        albedo, depth_m, x_m = file["albedo"][:], file["depth_m"][:], file["x_m"][:]
    bright = albedo > 0.5 * albedo.max()
    return float(np.ptp(x_m) * len(x_m) / (len(x_m) - 1)), float(np.nanmedian(depth_m[bright]))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("form", FORMS)
def test_the_wall_is_found_and_what_hides_stands_at_its_depth(nlos, tmp_path: Path, counts, form: str) -> None:
    path = write(tmp_path, form, counts)
    assert np.array_equal(np.moveaxis(read_any(path).transient.counts, 0, 2), counts)
    done = nlos("reconstruct", path.name, "-o", "direct")
    assert done.returncode == 0, done.stderr
    assert "the wall's size is not stored: by the direct times it is" in done.stderr
    width_m, depth_m = seen(tmp_path / "direct")
    assert width_m == pytest.approx(WIDTH_M, rel=0.02)
    assert depth_m == pytest.approx(DEPTH_M, abs=LCT_M)
    told = nlos("calibrate", path.name, "-o", "c.h5", "--json")
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["wall_size_m"] == pytest.approx(WIDTH_M, rel=0.02)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("form", ["sdt", "photons"])
def test_an_import_is_the_same_scan_and_nothing_is_overwritten(nlos, tmp_path: Path, counts, form: str) -> None:
    path = write(tmp_path, form, counts)
    done = nlos("import", path.name, "-o", "run.h5", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["imported"][0]["photons"] == counts.sum()
    assert "find the wall by the direct times" in done.stderr
    again = nlos("import", path.name, "-o", "run.h5")
    assert again.returncode == 6
    assert "run.h5: exists" in again.stderr
    said = ("--wall-size-m", "0.9x0.8", "--rectified")
    assert nlos("import", path.name, "-o", "run.h5", "--overwrite", *said).returncode == 0
    assert "0.9 x 0.8 m" in nlos("info", "run.h5").stdout
    for source, words in ((path.name, said), ("run.h5", ())):
        done = nlos("reconstruct", source, "-o", f"of_{source}", "--set", "snr=0.1", *words)
        assert done.returncode == 0, done.stderr
    pictures = []
    for source in (path.name, "run.h5"):
        with h5py.File(tmp_path / f"of_{source}" / "reconstruction.h5") as file:
            pictures.append(file["albedo"][:])
    assert np.array_equal(*pictures)
    assert nlos("reconstruct", path.name, "-o", "axes", "--axes", "TYX").returncode == 7


def test_an_archive_of_all_of_them_names_the_broken(nlos, tmp_path: Path, counts) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for form in FORMS:
        write(folder, form, counts)
    (folder / "cut.sdt").write_bytes((folder / "scan.sdt").read_bytes()[:4000])
    done = nlos("reconstruct", "in", "-o", "out", "--wall-size-m", "0.9")
    assert done.returncode == 7, done.stderr
    rows = {Path(row["file"]).name: row for row in json.loads((tmp_path / "out" / "archive.json").read_text())}
    assert {name: row["outcome"] for name, row in rows.items()} == {
        "scan.ptu": "done", "scan.sdt": "done", "scan.h5": "done", "cut.sdt": "failed",
    }  # fmt: skip
    assert "cut.sdt" in rows["cut.sdt"]["reason"]
    for name in ("scan.ptu", "scan.sdt", "scan.h5"):
        assert seen(tmp_path / "out" / name)[1] == pytest.approx(DEPTH_M, abs=LCT_M)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("form", ["sdt", "photons"])
def test_nano_sees_it_too(nlos, tmp_path: Path, counts, form: str) -> None:
    pytest.importorskip("torch")
    path = write(tmp_path, form, counts)
    done = nlos("reconstruct", path.name, "-o", "out", "--method", "nano", "--wall-size-m", "0.9")
    assert done.returncode == 0, done.stderr
    assert seen(tmp_path / "out")[1] == pytest.approx(DEPTH_M, abs=0.02)
