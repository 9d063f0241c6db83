"""Files as other labs write them: what is hidden is found where they put it, and what nobody can know is asked for."""

import gzip
import struct
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import ptufile
import pytest
from scipy.io import savemat

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import ImportedScan

ROWS, COLS, BINS, BIN_S = 12, 20, 256, 64e-12
WIDTH_M, HEIGHT_M, SPOT_M = 1.0, 0.6, (0.18, 0.12, 0.55)
LIGHT_M_PER_S = 299_792_458.0
X_M = (np.arange(COLS) + 0.5) / COLS * WIDTH_M - WIDTH_M / 2
Y_M = HEIGHT_M / 2 - (np.arange(ROWS) + 0.5) / ROWS * HEIGHT_M


def drawn(begins_s: float = 0.0) -> np.ndarray:
    """One photon path a point (H, W, T), to a spot right of the middle and above it, and back."""
    x, y, z = SPOT_M
    way_m = 2 * np.sqrt((X_M - x) ** 2 + (Y_M[:, None] - y) ** 2 + z**2)
    bins = np.floor((way_m / LIGHT_M_PER_S - begins_s) / BIN_S).astype(int)
    return (np.arange(BINS) == bins[..., None]) * np.uint16(900)


def is_found(scan: ImportedScan) -> None:
    """The spot is where it was put, by its distances r from the wall's points: r^2 is linear in its place."""
    held = scan.transient
    x, y = (axis[held.exposure_s > 0] for axis in np.meshgrid(held.wall.x_m(), held.wall.y_m()))
    bins = held.counts.argmax(axis=0)[held.exposure_s > 0]
    r = (held.time.start_s + (bins + 0.5) * held.time.bin_width_s) * LIGHT_M_PER_S / 2
    (twice_x, twice_y, whole), *_ = np.linalg.lstsq(np.c_[-x, -y, np.ones_like(x)], r**2 - x**2 - y**2)
    at = twice_x / 2, twice_y / 2, np.sqrt(whole - (twice_x**2 + twice_y**2) / 4)
    assert at == pytest.approx(SPOT_M, abs=0.004)


def write(path: Path, counts: np.ndarray, on: str = "file", said: dict[str, Any] | None = None, **create: Any) -> Path:
    with h5py.File(path, "w", userblock_size=create.pop("userblock_size", 0)) as file:
        held = file.create_dataset("histograms", data=counts, **create)
        facts = {"bin_width_s": BIN_S, "wall_size_m": (WIDTH_M, HEIGHT_M), "rectified": 1} | (said or {})
        (file if on == "file" else held).attrs.update({key: value for key, value in facts.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("counts", "how"),
    [
        (drawn().astype(">u2"), {"chunks": (5, 7, 100), "compression": "gzip", "shuffle": True, "fletcher32": True}),
        (drawn().astype("f2"), {"compression": "lzf"}),
        (drawn().astype(">i8")[None], {}),
        (drawn()[..., None], {}),
        (drawn(), {"on": "dataset"}),
        (drawn(), {"userblock_size": 1024}),
    ],
)
def test_hdf5_as_others_write_it(tmp_path: Path, counts: np.ndarray, how: dict[str, Any]) -> None:
    is_found(read_any(write(tmp_path / "scan.h5", counts, **how)))


def test_hdf5_that_python_calls_mat_is_in_pythons_order(tmp_path: Path) -> None:
    is_found(read_any(write(tmp_path / "scan.mat", drawn())))


def test_what_matlab_writes_is_in_matlabs_order_whatever_it_is_called(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "scan.h5", "w", userblock_size=512) as file:
        for key, value in {
            "histograms": drawn().T,
            "bin_width_s": BIN_S,
            "wall_size_m": [[WIDTH_M], [HEIGHT_M]],
        }.items():
            file[key] = value
            file[key].attrs["MATLAB_class"] = np.bytes_("double")
    is_found(read_any(tmp_path / "scan.h5"))
    savemat(
        tmp_path / "five.dat",
        {"histograms": drawn(), "bin_width_s": BIN_S, "wall_size_m": [WIDTH_M, HEIGHT_M]},
        appendmat=False,
    )
    is_found(read_any(tmp_path / "five.dat"))


def test_points_that_are_not_numbers_are_not_measured(tmp_path: Path) -> None:
    counts = drawn().astype(np.float32)
    counts[2, 3] = np.nan
    scan = read_any(write(tmp_path / "nan.h5", counts))
    assert scan.transient.exposure_s[2, 3] == 0
    assert (scan.transient.exposure_s == 0).sum() == 1
    assert any("1 points hold NaN" in note for note in scan.notes)
    is_found(scan)
    counts[4, 5, :7] = np.nan
    with pytest.raises(InvalidData, match="row 4, column 5, bin 0 is not a number"):
        read_any(write(tmp_path / "some.h5", counts))
    path = write(tmp_path / "told.h5", counts)
    with h5py.File(path, "r+") as file:
        file["exposure_s"] = np.where(np.isnan(counts).any(axis=2), 0.0, 2.0)
    is_found(read_any(path))


def test_bins_before_time_0_of_a_rectified_scan_are_left_out(tmp_path: Path) -> None:
    begins_s = -20.4 * BIN_S
    scan = read_any(write(tmp_path / "early.h5", drawn(begins_s), said={"offset_s": begins_s, "direct_cut_bins": 25}))
    assert scan.transient.time.bins == BINS - 21
    assert scan.transient.time.start_s == pytest.approx(0.6 * BIN_S)
    assert scan.direct_cut_bins == 4
    is_found(scan)
    with pytest.raises(InvalidData, match="of a raw scan it cannot be below 0"):
        read_any(write(tmp_path / "raw.h5", drawn(), said={"offset_s": begins_s, "rectified": 0}))


@pytest.mark.parametrize(
    ("order", "axes"), [((2, 0, 1), "TYX"), ((0, 2, 1), "YTX"), ((1, 0, 2), "XYT"), ((2, 1, 0), "TXY")]
)
def test_another_order_is_asked_about_and_read_when_it_is_said(
    tmp_path: Path, order: tuple[int, ...], axes: str
) -> None:
    path = write(tmp_path / "scan.h5", drawn().transpose(order))
    with pytest.raises(InvalidData, match=f"--axes {axes[0]}"):
        read_any(path)
    is_found(read_any(path, Given(axes=axes)))


def test_an_array_alone_needs_its_bin_width_and_wall(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", np.asfortranarray(drawn().astype(">u4")))
    with pytest.raises(InvalidData, match="--bin-width-ps"):
        read_any(tmp_path / "scan.npy")
    with pytest.raises(InvalidData, match="--wall-size-m"):
        read_any(tmp_path / "scan.npy", Given(bin_width_s=BIN_S))
    is_found(read_any(tmp_path / "scan.npy", Given(bin_width_s=BIN_S, wall_m=(WIDTH_M, HEIGHT_M))))


def test_files_are_told_by_what_they_hold(tmp_path: Path) -> None:
    with (tmp_path / "scan.h5").open("wb") as file:
        np.savez(file, histograms=drawn(), bin_width_s=BIN_S, wall_size_m=(WIDTH_M, HEIGHT_M))
    is_found(read_any(tmp_path / "scan.h5"))
    (tmp_path / "scan.h5.gz").write_bytes(gzip.compress((tmp_path / "scan.h5").read_bytes()))
    with pytest.raises(InvalidData, match="is packed by gzip"):
        read_any(tmp_path / "scan.h5.gz")


def test_archives_are_told_from_arrays_and_from_workbooks(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", drawn())
    with tarfile.open(tmp_path / "lab.tar", "w") as tar:
        tar.add(tmp_path / "scan.npy", "scan.npy")
    for name in ("lab.zip", "lab.xlsx"):
        with zipfile.ZipFile(tmp_path / name, "w") as packed:
            packed.write(tmp_path / "scan.npy", "scan.npy")
            packed.writestr("scan.log", "bins of 64 ps")
    with pytest.raises(InvalidData, match=r"is packed by tar\. Unpack it"):
        read_any(tmp_path / "lab.tar")
    with pytest.raises(InvalidData, match=r"is packed by ZIP\. Unpack it"):
        read_any(tmp_path / "lab.zip")
    with pytest.raises(InvalidData, match=r"in no format that is read here .*'\.xlsx'.*In Python"):
        read_any(tmp_path / "lab.xlsx")


@pytest.mark.parametrize("name", ["zarr.json", ".zgroup", ".zarray"])
def test_a_zarr_store_is_no_folder_of_files(tmp_path: Path, name: str) -> None:
    (tmp_path / "scan.zarr").mkdir()
    (tmp_path / "scan.zarr" / name).write_text("{}")
    with pytest.raises(IsADirectoryError, match=r"is a Zarr store, which is not read here\. In Python"):
        read_any(tmp_path / "scan.zarr")


def test_numpys_files_of_python_objects_are_told_as_such(tmp_path: Path) -> None:
    np.save(tmp_path / "dict.npy", {"data": drawn()}, allow_pickle=True)  # type: ignore[arg-type]
    np.savez(tmp_path / "list.npz", histograms=np.array([[1], [1, 2]], dtype=object), bin_width_s=BIN_S)
    for name in ("dict.npy", "list.npz"):
        with pytest.raises(InvalidData, match=r"holds Python objects .* of a dict with \.item\(\)\. In Python"):
            read_any(tmp_path / name)


@pytest.mark.parametrize(
    "beside",
    [
        {
            "wall_size": WIDTH_M,
            "time_bin": BIN_S,
            "speed_light": 3e8,
        },  # NeTF (Shen et al., ICCP 2021), its measured scenes
        {
            "deltaT": BIN_S * LIGHT_M_PER_S,
            "cameraGridPositions": np.zeros((3, 240)),
            "hiddenVolumeSize": 0.8,
        },  # its others
    ],
)
@pytest.mark.parametrize("key", ["data", "rect_data"])
def test_a_published_name_with_facts_of_another_lab_is_not_taken_for_that_format(
    tmp_path: Path, key: str, beside: dict[str, Any]
) -> None:
    savemat(tmp_path / "lab.mat", {key: drawn(), **beside})
    with pytest.raises(InvalidData, match=r"may say otherwise\. Say what holds: --bin-width-ps and --wall-size-m"):
        read_any(tmp_path / "lab.mat")
    is_found(read_any(tmp_path / "lab.mat", Given((WIDTH_M, HEIGHT_M), BIN_S, "YXT", True)))


@pytest.mark.parametrize("told", [Given(), Given((WIDTH_M, HEIGHT_M), BIN_S, "YXT", True)])
@pytest.mark.parametrize("key", ["data", "rect_data"])
def test_a_scan_by_the_laser_alone_is_not_confocal(tmp_path: Path, key: str, told: Given) -> None:
    """Fast RSD (Liu et al., 2020): one SPAD."""
    savemat(tmp_path / "lab.mat", {key: drawn(), "ts": BIN_S, "sampling_spacing": 0.05, "SPAD_index": [[3, 4]]})
    with pytest.raises(InvalidData, match="holds SPAD_index: a scan by the laser alone"):
        read_any(tmp_path / "lab.mat", told)


def test_a_published_name_with_our_facts_or_its_scripts_is_read_by_these(tmp_path: Path) -> None:
    savemat(tmp_path / "ours.mat", {"data": drawn(), "bin_width_s": BIN_S, "wall_size_m": [WIDTH_M, HEIGHT_M]})
    is_found(read_any(tmp_path / "ours.mat"))
    savemat(tmp_path / "fk.mat", {"meas": drawn(), "wall_size": WIDTH_M, "bin_resolution": BIN_S})
    scan = read_any(tmp_path / "fk.mat")
    is_found(scan)
    assert any("1 x 0.6 m, points as far apart in x as in y" in note for note in scan.notes)


def test_what_a_published_format_does_not_store_is_said(tmp_path: Path) -> None:
    counts = np.zeros((128, 128, 512), np.uint16)
    counts[60:72, 60:80, :BINS] = drawn()
    savemat(tmp_path / "alone.mat", {"data": counts}, do_compression=True)
    scan = read_any(tmp_path / "alone.mat")
    assert (scan.transient.wall.width_m, scan.transient.wall.height_m) == (2.0, 2.0)
    assert any("assuming 2 m" in note for note in scan.notes)
    assert any("assuming 32 ps" in note for note in scan.notes)
    savemat(tmp_path / "turned.mat", {"data": np.moveaxis(drawn(), 2, 0)})
    with pytest.raises(InvalidData, match="--axes TYX"):
        read_any(tmp_path / "turned.mat")


def write_phu(path: Path, curves: list[tuple[np.ndarray, float]]) -> Path:
    """As PicoQuant's software writes histograms: tags of 48 bytes, then counts; texts in tags of two kinds."""
    integer, real, text, wide, end = 0x10000008, 0x20000008, 0x4001FFFF, 0x4002FFFF, 0xFFFF0008

    def tag(name: str, index: int, kind: int, value: Any) -> bytes:
        head = name.encode().ljust(32, b"\0") + struct.pack("<iI", index, kind)
        if kind in (text, wide):
            held = value.encode("ascii" if kind == text else "utf-16-le") + b"\0\0"
            held += b"\0" * (-len(held) % 8)
            return head + struct.pack("<q", len(held)) + held
        return head + struct.pack("<d" if kind == real else "<q", value)

    def head(at: int) -> bytes:
        tags = [
            tag("CreatorSW_Name", -1, text, "MultiHarp Software"),
            tag("File_Comment", -1, wide, "Büro, Wand №1"),
            tag("HW_Type", -1, text, "MultiHarp 150"),
            tag("Measurement_Mode", -1, integer, 0),
            tag("Measurement_SubMode", -1, integer, 1),
            tag("HistoResult_NumberOfCurves", -1, integer, len(curves)),
            tag("HistoResult_BitsPerBin", -1, integer, 32),
        ]
        for index, (counts, width_s) in enumerate(curves):
            tags += [
                tag("HistResDscr_CurveIndex", index, integer, index),
                tag("HistResDscr_HistogramBins", index, integer, counts.size),
                tag("HistResDscr_MDescResolution", index, real, width_s),
                tag("HistResDscr_MDescStopAfter", index, integer, 250),
                tag("HistResDscr_IntegralCount", index, integer, int(counts.sum())),
                tag("HistResDscr_DataOffset", index, integer, at),
            ]
            at += 4 * counts.size
        return b"PQHISTO\x001.0.00\0\0" + b"".join(tags) + tag("Header_End", -1, end, 0)

    path.write_bytes(head(len(head(0))) + b"".join(counts.astype("<u4").tobytes() for counts, _ in curves))
    return path


@pytest.mark.parametrize("points", [1, 3])
def test_a_phu_is_a_row_of_points_as_ptufile_reads_it(tmp_path: Path, points: int) -> None:
    counts = np.random.default_rng(0).poisson(3.0, (points, 4096)).astype(np.uint32)
    path = write_phu(tmp_path / "row.phu", [(each, 20e-12) for each in counts])
    with ptufile.PhuFile(path) as phu:
        assert np.array_equal(np.stack(phu.histograms()), counts)
    scan = read_any(path)
    assert np.array_equal(scan.transient.counts[:, 0], counts.T)
    assert scan.transient.time.bin_width_s == 20e-12
    assert np.allclose(scan.transient.exposure_s, 0.25)
    assert not scan.rectified
    path.rename(tmp_path / "row.dat")  # it is told by its contents
    assert read_any(tmp_path / "row.dat").transient.counts.sum() == counts.sum()


def test_a_phu_that_is_cut_off_or_contradicts_itself_is_refused(tmp_path: Path) -> None:
    path = write_phu(tmp_path / "row.phu", [(np.arange(64), 8e-12), (np.arange(32), 9e-12)])
    with pytest.raises(InvalidData, match="bins do not fit"):
        read_any(path)
    whole = write_phu(path, [(np.arange(64), 8e-12)]).read_bytes()
    for keep in (12, 60, 300, len(whole) - 4):
        path.write_bytes(whole[:keep])
        with pytest.raises(InvalidData, match=r"row\.phu"):
            read_any(path)


def test_a_ptu_of_one_point_is_one_point(tmp_path: Path) -> None:
    image = np.random.default_rng(0).poisson(0.4, (1, 4, 5, 2, 200)).astype(np.uint16)
    path = tmp_path / "point.ptu"
    ptufile.imwrite(path, image, 1e-7, 25e-12, 1e-3, record_type=ptufile.PtuRecordType.GenericT3)
    data = bytearray(path.read_bytes())
    at = data.index(b"Measurement_SubMode") + 40
    data[at : at + 8] = struct.pack("<q", 1)
    path.write_bytes(data)
    scan = read_any(path)
    assert scan.source_format == "PTU point"
    assert np.array_equal(scan.transient.counts[:200, 0, 0], image.sum(axis=(0, 1, 2, 3)))
    assert any("2 detectors are added up (0: " in note for note in scan.notes)
    for keep in (20, 70, 400):
        path.write_bytes(data[:keep])
        with pytest.raises(InvalidData, match=r"point\.ptu"):
            read_any(path)


def test_a_wall_that_nobody_told_has_points_as_far_apart_in_x_as_in_y(tmp_path: Path) -> None:
    scan = read_any(write(tmp_path / "raw.h5", drawn(), said={"wall_size_m": None, "rectified": 0}))
    assert (scan.transient.wall.width_m, scan.transient.wall.height_m) == (1.0, pytest.approx(0.6))
    assert not scan.wall_known
