"""MATLAB scans of four groups arrive upright, with their geometry, and broken ones are refused by name."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import DOUBT
from nlos.acquisition.importers.mat5_types import no_number
from nlos.acquisition.importers.matlab import read_matlab
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.loaded import load_scan

COUNTS = np.arange(3 * 2 * 5, dtype=np.uint16).reshape(3, 2, 5)
TOLD = {"bin_resolution": 32e-12, "wall_size": 2.0}
"""What has to be said of counts of a shape that no published scan has."""


def published(*shape: int) -> np.ndarray:
    """`COUNTS` in a corner of a scan of a published shape."""
    counts = np.zeros(shape, dtype=np.uint16)
    counts[:3, :2, :5] = COUNTS
    return counts


def test_otoole_is_transposed_and_flipped_so_that_pictures_read_correctly(tmp_path: Path) -> None:
    counts = published(32, 32, 4096)
    savemat(tmp_path / "s.mat", {"rect_data": counts, "width": 0.35}, do_compression=True)
    scan = read_matlab(tmp_path / "s.mat")
    assert np.array_equal(scan.transient.counts, counts.transpose(1, 0, 2)[:, ::-1].transpose(2, 0, 1))
    assert scan.transient.wall.width_m == pytest.approx(0.7)
    assert scan.transient.time.bin_width_s == 4e-12
    assert scan.falloff == 2
    assert any("--set falloff=4" in note for note in scan.notes)


def test_fk_offsets_come_from_tofgrid_beside_it_in_picoseconds(tmp_path: Path) -> None:
    savemat(tmp_path / "meas_10min.mat", {"meas": COUNTS})
    with pytest.raises(InvalidData, match=r"512 x 512 x 2048, and these 3 x 2 x 5.*--bin-width-ps and --wall-size-m"):
        read_matlab(tmp_path / "meas_10min.mat")
    assert read_matlab(tmp_path / "meas_10min.mat", Given(wall_m=(2.0, 2.0), bin_width_s=32e-12)).rectified
    savemat(tmp_path / "tof.mat", {"tofgrid": np.full((3, 2), 64.0)})
    scan = read_matlab(tmp_path / "meas_10min.mat")
    assert any(note.startswith(f"{DOUBT} tofgrid says at most 64 ps") for note in scan.notes)
    assert scan.time_offset_bins is not None
    assert np.allclose(scan.time_offset_bins, 2.0)
    assert not scan.rectified


@pytest.mark.parametrize(
    ("units_of_a_picosecond", "within"), [(1e-12, "below one bin"), (1e-3, "below one bin"), (1e3, "beyond all 512")]
)
def test_a_tofgrid_that_no_picoseconds_make_is_refused(
    tmp_path: Path, units_of_a_picosecond: float, within: str
) -> None:
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 64)])
    picoseconds = 2e12 / SPEED_OF_LIGHT_M_PER_S * np.sqrt(x**2 + y**2 + 1.7**2)
    path = tmp_path / "m.mat"
    savemat(path, {"meas": published(64, 64, 512), "tofgrid": picoseconds})
    assert not any(note.startswith(DOUBT) for note in read_matlab(path).notes)
    savemat(path, {"meas": published(64, 64, 512), "tofgrid": picoseconds * units_of_a_picosecond})
    with pytest.raises(InvalidData, match=f"{within}.*Picoseconds to each point and back are expected"):
        read_matlab(path)
    savemat(path, {"meas": published(64, 64, 512), "tofgrid": picoseconds / 32})
    assert any("Is it in bins?" in note for note in read_matlab(path).notes if note.startswith(DOUBT))


@pytest.mark.parametrize(
    ("bins", "rectified", "doubted"), [(2048, None, True), (512, None, False), (2048, True, False)]
)
def test_raw_measurements_without_their_times_are_not_taken_for_rectified_silently(
    tmp_path: Path, bins: int, rectified: bool | None, doubted: bool, caplog: pytest.LogCaptureFixture
) -> None:
    savemat(tmp_path / "m.mat", {"meas": published(64, 64, bins)}, do_compression=True)
    with caplog.at_level("WARNING", "nlos"):
        load_scan(tmp_path / "m.mat", Given(rectified=rectified))
    assert ("If it is raw: --raw, or put its tof.mat beside it" in caplog.text) == doubted


def test_version_73_files_have_their_axes_reversed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        file["data"] = published(128, 128, 512).transpose(2, 1, 0)
    scan = read_matlab(tmp_path / "v73.mat")
    assert np.array_equal(scan.transient.counts[:5, :3, :2], COUNTS.transpose(2, 0, 1))
    assert scan.transient.time.bin_width_s == 32e-12
    assert "USTC" in scan.source_format


@pytest.mark.parametrize("name", ["meas", "bin_resolution", "wall_size"])
def test_a_variable_of_version_73_that_holds_no_value_is_told_as_such(tmp_path: Path, name: str) -> None:
    path = tmp_path / "scan.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["meas"], file["bin_resolution"], file["wall_size"] = np.ones((64, 4, 4)), 32e-12, 2.0
        del file[name]
        file[name] = h5py.Empty("f8")
    with pytest.raises(InvalidData, match=name):
        read_matlab(path)


def test_other_contents_are_refused_by_name(tmp_path: Path) -> None:
    savemat(tmp_path / "other.mat", {"picture": np.ones((2, 2))})
    with pytest.raises(InvalidData, match="picture"):
        read_matlab(tmp_path / "other.mat")
    savemat(tmp_path / "flat.mat", {"meas": np.ones((2, 2))})
    with pytest.raises(InvalidData, match="meas"):
        read_matlab(tmp_path / "flat.mat")


def test_a_struct_of_version_73_is_named_with_what_is_in_it(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "struct.mat", "w", userblock_size=512) as file:
        file["lab/hist"], file["lab/dt"], file["#refs#/a"] = COUNTS, 32e-12, 1
        file["far"] = h5py.ExternalLink("elsewhere.h5", "/")
    with pytest.raises(InvalidData, match="far: is a link to elsewhere"):
        read_matlab(tmp_path / "struct.mat")
    with h5py.File(tmp_path / "struct.mat", "r+") as file:
        del file["far"]
    with pytest.raises(InvalidData, match=r"the file holds lab \(a struct: dt, hist\)\. "):
        read_matlab(tmp_path / "struct.mat")


def test_what_holds_no_numbers_in_version_5_is_named_as_what_it_is(tmp_path: Path) -> None:
    savemat(tmp_path / "lab.mat", {"scan": {"hist": COUNTS}, "each": np.array([COUNTS, "b"], dtype=object), "dt": 32})
    with pytest.raises(InvalidData, match=r"the file holds dt, scan \(a struct\), each \(a cell\)\. "):
        read_matlab(tmp_path / "lab.mat")


def test_a_word_for_yes_is_refused_until_the_user_says_it(tmp_path: Path) -> None:
    savemat(
        tmp_path / "scan.mat", {"histograms": COUNTS, "bin_width_s": 32e-12, "wall_size_m": 2.0, "rectified": "yes"}
    )
    with pytest.raises(InvalidData, match=r"rectified is 'yes'; true or false, .*--rectified or --raw"):
        read_matlab(tmp_path / "scan.mat")
    assert read_matlab(tmp_path / "scan.mat", Given(rectified=True)).rectified


@pytest.mark.parametrize(
    ("held", "why"),
    [
        (scipy.sparse.csc_array(np.eye(3)), r"is sparse\. Save full\(meas\)"),
        (np.ones((2, 2, 3)) * 1j, r"is complex, and counts are not\. Save real\(meas\)"),
        ({"hist": COUNTS}, r"is a struct of hist\. Save its fields: save\(FILE, '-struct', 'meas'\)"),
        (np.array([COUNTS, "b"], dtype=object), r"is a cell array\. Save the numbers in it, such as meas\{1\}"),
        ("counts", "is text, not numbers"),
        (np.zeros((0, 0)), "is empty"),
    ],
)
def test_what_is_no_full_array_of_real_numbers_is_named(tmp_path: Path, held: object, why: str) -> None:
    savemat(tmp_path / "scan.mat", {"meas": held, **TOLD, "bin_width_s": 32e-12})
    with pytest.raises(InvalidData, match=f"meas: {why}"):
        read_matlab(tmp_path / "scan.mat")


def test_an_empty_array_of_version_73_is_not_read_as_its_shape(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "scan.mat", "w", userblock_size=512) as file:
        file["histograms"], file["bin_width_s"], file["wall_size_m"] = COUNTS.T, [[32e-12]], [[2.0]]
        file["response"] = np.array([1, 0], np.uint64)  # so MATLAB stores zeros(1, 0)
        file["response"].attrs["MATLAB_class"], file["response"].attrs["MATLAB_empty"] = np.bytes_("double"), 1
    with pytest.raises(InvalidData, match="response: is empty"):
        read_matlab(tmp_path / "scan.mat")


def test_a_sparse_array_of_version_73_is_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "scan.mat", "w", userblock_size=512) as file:
        for name in ("data", "ir", "jc"):
            file[f"histograms/{name}"] = np.arange(3)
        file["histograms"].attrs["MATLAB_sparse"] = np.uint64(3)
    with pytest.raises(InvalidData, match=r"the file holds histograms \(sparse: save full\(histograms\)\)\. "):
        read_matlab(tmp_path / "scan.mat")


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".txt"])
@pytest.mark.parametrize("kind", ["text", "binary", "hdf5"])
def test_octaves_own_formats_are_refused_with_what_to_save(tmp_path: Path, kind: str, suffix: str) -> None:
    path = tmp_path / f"scan{suffix}"
    if kind == "hdf5":
        with h5py.File(path, "w") as file:
            file["histograms/type"], file["histograms/value"] = np.bytes_("uint16 matrix"), COUNTS
            file["histograms"].attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
    else:
        path.write_bytes(b"Octave-1-L\0" if kind == "binary" else b"# Created by Octave 7.3.0\n# name: histograms\n")
    with pytest.raises(InvalidData, match=r"In Octave: x = load\(FILE\); save\('-v7', 'scan\.mat', '-struct', 'x'\)"):
        read_any(path)


def test_text_that_another_program_created_is_not_called_octaves(tmp_path: Path) -> None:
    (tmp_path / "scan.txt").write_text("# Created by LabVIEW 2023\n1 2 3\n", encoding="ascii")
    with pytest.raises(InvalidData, match="in no format that is read here"):
        read_any(tmp_path / "scan.txt")


@pytest.mark.parametrize(("position", "value"), [(184, 0), (185, 1), (184, 14)])
def test_numbers_of_no_type_are_refused(tmp_path: Path, position: int, value: int) -> None:
    """SciPy 1.17 ends the process on the first two."""
    savemat(tmp_path / "typed.mat", {"meas": COUNTS, **TOLD})
    raw = bytearray((tmp_path / "typed.mat").read_bytes())
    raw[position] = value
    (tmp_path / "typed.mat").write_bytes(bytes(raw))
    with pytest.raises(InvalidData, match=r"typed\.mat: meas: cannot be read \(its numbers are of type"):
        read_matlab(tmp_path / "typed.mat")


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "f4", "f8", "u8", "i8"])
def test_numbers_of_every_type_are_read(tmp_path: Path, packed: bool, kind: str) -> None:
    savemat(tmp_path / "typed.mat", {"other": np.ones(3), "meas": COUNTS.astype(kind), **TOLD}, do_compression=packed)
    assert no_number(tmp_path / "typed.mat", "meas") is None
    assert read_matlab(tmp_path / "typed.mat").transient.counts.sum() == COUNTS.sum()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(position=st.integers(0, 400), value=st.integers(0, 255), length=st.integers(0, 600), packed=st.booleans())
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, position: int, value: int, length: int, packed: bool
) -> None:
    savemat(tmp_path / "whole.mat", {"meas": COUNTS, **TOLD}, do_compression=packed)
    raw = bytearray((tmp_path / "whole.mat").read_bytes())
    raw[position % len(raw)] = value
    damaged = tmp_path / "damaged.mat"
    damaged.write_bytes(bytes(raw[: max(1, len(raw) - length)]))
    try:
        read_matlab(damaged)
    except InvalidData as error:
        message = str(error)
    else:
        return
    assert "damaged.mat" in message


@pytest.mark.parametrize(
    ("key", "shape", "axes"),
    [
        ("meas", (512, 32, 32), None),  # Lindell and Wetzstein 2020: through scattering media, 16 ps, 0.6 m
        ("meas", (512, 32, 32), "TYX"),
        ("data", (30, 30, 1024), None),  # general-NLOS: a list of free points, made square
        ("rect_data", (64, 64, 512), None),
    ],
)
def test_counts_of_no_published_shape_are_not_given_a_published_scans_bins(
    tmp_path: Path, key: str, shape: tuple[int, ...], axes: str | None
) -> None:
    savemat(tmp_path / "lab.mat", {key: np.ones(shape, np.uint8)}, do_compression=True)
    with pytest.raises(InvalidData, match=f"and these {shape[0]} x {shape[1]} x {shape[2]}: bins of"):
        read_matlab(tmp_path / "lab.mat", Given(axes=axes))
    told = Given(wall_m=(0.6, 0.6), bin_width_s=16e-12, axes=axes or "YXT")
    assert read_matlab(tmp_path / "lab.mat", told).transient.time.bin_width_s == 16e-12


def test_cells_of_version_73_and_several_frames_are_told_what_to_save(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "scan.mat", "w", userblock_size=512) as file:
        file["#refs#/a"] = COUNTS.T
        file.create_dataset("scans", data=[[file["#refs#/a"].ref]], dtype=h5py.ref_dtype)
    with pytest.raises(InvalidData, match=r"the file holds scans \(a cell\)\. "):
        read_matlab(tmp_path / "scan.mat")
    with h5py.File(tmp_path / "scan.mat", "a") as file:
        file.move("scans", "histograms")
    with pytest.raises(
        InvalidData, match=r"histograms: is a cell array\. Save the numbers in it, such as histograms\{1\}"
    ):
        read_matlab(tmp_path / "scan.mat")
    savemat(tmp_path / "frames.mat", {"meas": np.stack(4 * [COUNTS])})
    with pytest.raises(InvalidData, match=r"meas: has shape .*Save one: meas = squeeze\(meas\(1, :, :, :\)\)"):
        read_matlab(tmp_path / "frames.mat")
