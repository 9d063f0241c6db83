"""MATLAB scans of four groups arrive upright, with their geometry, and broken ones are refused by name."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.mat5_types import no_number
from nlos.acquisition.importers.matlab import read_matlab

COUNTS = np.arange(3 * 2 * 5, dtype=np.uint16).reshape(3, 2, 5)


def test_otoole_is_transposed_and_flipped_so_that_pictures_read_correctly(tmp_path: Path) -> None:
    savemat(tmp_path / "s.mat", {"rect_data": COUNTS, "width": 0.35}, do_compression=True)
    scan = read_matlab(tmp_path / "s.mat")
    assert np.array_equal(scan.transient.counts, COUNTS.transpose(1, 0, 2)[:, ::-1].transpose(2, 0, 1))
    assert scan.transient.wall.width_m == pytest.approx(0.7)
    assert scan.transient.time.bin_width_s == 4e-12
    assert any("falloff" in note for note in scan.notes)


def test_fk_offsets_come_from_tofgrid_beside_it_in_picoseconds(tmp_path: Path) -> None:
    savemat(tmp_path / "meas_10min.mat", {"meas": COUNTS})
    assert read_matlab(tmp_path / "meas_10min.mat").rectified
    savemat(tmp_path / "tof.mat", {"tofgrid": np.full((3, 2), 64.0)})
    scan = read_matlab(tmp_path / "meas_10min.mat")
    assert scan.time_offset_bins is not None
    assert np.allclose(scan.time_offset_bins, 2.0)
    assert not scan.rectified


def test_version_73_files_have_their_axes_reversed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        file["data"] = COUNTS.transpose(2, 1, 0)
    scan = read_matlab(tmp_path / "v73.mat")
    assert np.array_equal(scan.transient.counts, COUNTS.transpose(2, 0, 1))
    assert "USTC" in scan.source_format


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


@pytest.mark.parametrize(("position", "value"), [(184, 0), (185, 1), (184, 14)])
def test_numbers_of_no_type_are_refused(tmp_path: Path, position: int, value: int) -> None:
    """SciPy 1.17 ends the process on the first two."""
    savemat(tmp_path / "typed.mat", {"meas": COUNTS})
    raw = bytearray((tmp_path / "typed.mat").read_bytes())
    raw[position] = value
    (tmp_path / "typed.mat").write_bytes(bytes(raw))
    with pytest.raises(InvalidData, match=r"typed\.mat: meas: cannot be read \(its numbers are of type"):
        read_matlab(tmp_path / "typed.mat")


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "f4", "f8", "u8", "i8"])
def test_numbers_of_every_type_are_read(tmp_path: Path, packed: bool, kind: str) -> None:
    savemat(tmp_path / "typed.mat", {"other": np.ones(3), "meas": COUNTS.astype(kind)}, do_compression=packed)
    assert no_number(tmp_path / "typed.mat", "meas") is None
    assert read_matlab(tmp_path / "typed.mat").transient.counts.sum() == COUNTS.sum()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(position=st.integers(0, 400), value=st.integers(0, 255), length=st.integers(0, 600), packed=st.booleans())
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, position: int, value: int, length: int, packed: bool
) -> None:
    savemat(tmp_path / "whole.mat", {"meas": COUNTS}, do_compression=packed)
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
