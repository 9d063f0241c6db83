"""Plain HDF5 scans are read as they are, and refused by name where they are not scans."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.plain import read_plain


def write(path: Path, counts: np.ndarray, **attributes: object) -> Path:
    with h5py.File(path, "w") as file:
        file["histograms"] = counts
        for key, value in {"bin_width_s": 4e-12, "wall_size_m": 0.7, **attributes}.items():
            file.attrs[key] = value
    return path


def test_counts_axes_and_wall_arrive_unchanged(tmp_path: Path) -> None:
    counts = np.arange(2 * 3 * 5, dtype=np.uint16).reshape(2, 3, 5)
    path = write(tmp_path / "scan.h5", counts, wall_size_m=[1.5, 1.0], direct_cut_bins=2, falloff_exponent_authors=2)
    plain = read_plain(path)
    assert np.array_equal(plain.transient.counts, counts.transpose(2, 0, 1))
    assert (plain.transient.wall.width_m, plain.transient.wall.height_m) == (1.5, 1.0)
    assert (plain.direct_cut_bins, plain.falloff, plain.rectified) == (2, 2, True)


def test_numbers_that_netcdf_packed_are_unpacked(tmp_path: Path) -> None:
    """xarray's `encoding` stores twice the counts less 10, and -99 where nothing was measured."""
    counts = np.arange(2 * 3 * 5).reshape(2, 3, 5)
    path = write(tmp_path / "scan.nc", (counts * 2 - 10).astype(np.int16))
    with h5py.File(path, "r+") as file:
        packed = file["histograms"]
        packed[1, 2] = -99
        packed.attrs.update({"scale_factor": 0.5, "add_offset": 5.0, "_FillValue": np.array([-99], np.int16)})
        del file.attrs["wall_size_m"]
        file["x_m"], file["y_m"] = np.array([-1, 0, 1], np.int8), np.array([1, -1], np.int8)
        for places in (file["x_m"], file["y_m"]):
            places.attrs["scale_factor"] = 0.1
    plain = read_plain(path)
    counts[1, 2] = 0
    assert np.array_equal(plain.transient.counts, counts.transpose(2, 0, 1))
    assert plain.transient.exposure_s.tolist() == [[1, 1, 1], [1, 1, 0]]
    assert (plain.transient.wall.width_m, plain.transient.wall.height_m) == pytest.approx((0.3, 0.4))
    assert not any("scale_factor" in note for note in plain.notes)
    with h5py.File(path, "r+") as file:
        file["histograms"].attrs["scale_factor"] = "half"
    with pytest.raises(InvalidData, match="histograms: scale_factor of it is not one number"):
        read_plain(path)


@pytest.mark.parametrize(
    ("attributes", "named"),
    [
        ({"bin_width_s": 0.0}, "bin_width_s"),
        ({"bin_width_s": "fast"}, "bin_width_s"),
        ({"bin_width_s": np.nan}, "bin_width_s"),
        ({"wall_size_m": -1.0}, "wall_size_m"),
        ({"wall_size_m": [1.0, 1.0, 1.0]}, "wall_size_m"),
        ({"direct_cut_bins": 5}, "direct_cut_bins"),
        ({"falloff_exponent_authors": 3}, "falloff_exponent_authors"),
    ],
)
def test_wrong_attributes_are_refused_by_name(tmp_path: Path, attributes: dict[str, object], named: str) -> None:
    path = write(tmp_path / "scan.h5", np.ones((2, 2, 5), np.uint8), **attributes)
    with pytest.raises(InvalidData, match=named):
        read_plain(path)


def test_wrong_shape_text_and_missing_dataset_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="2 dimensions"):
        read_plain(write(tmp_path / "flat.h5", np.ones((2, 5), np.uint8)))
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["other"] = np.ones(3)
    with pytest.raises(InvalidData, match="holds other"):
        read_plain(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("not a scan")
    with pytest.raises(InvalidData, match=r"text\.h5"):
        read_plain(tmp_path / "text.h5")


@pytest.mark.parametrize("beside", [{}, {"x_m": np.zeros(4), "y_m": np.zeros(4)}])
def test_a_dataset_that_holds_no_value_is_told_as_such(tmp_path: Path, beside: dict[str, object]) -> None:
    """HDF5's null dataspace, which has no shape at all."""
    path = tmp_path / "plain.h5"
    with h5py.File(path, "w") as file:
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = 32e-12, 1.0
        for name, value in {"histograms": h5py.Empty("u2"), **beside}.items():
            file[name] = value
    with pytest.raises(InvalidData, match=r"histograms: is empty: it has a type and holds no value"):
        read_plain(path)


def test_a_filter_that_is_absent_here_is_named(tmp_path: Path) -> None:
    """Blosc's number in place of gzip's, which lies eight bytes before the filter's name."""
    path = tmp_path / "packed.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("histograms", data=np.ones((4, 4, 64)), compression="gzip")
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = 32e-12, 1.0
    data = bytearray(path.read_bytes())
    at = data.index(b"deflate\0") - 8
    assert data[at : at + 2] == b"\x01\0"
    data[at : at + 2] = (32001).to_bytes(2, "little")
    path.write_bytes(data)
    with pytest.raises(InvalidData, match=r"histograms: is packed by deflate, a filter .*h5repack -f GZIP=4 .*packed"):
        read_plain(path)
    with h5py.File(path, "r+") as file:
        file.attrs["PYTABLES_FORMAT_VERSION"] = "2.1"  # whose Blosc no other program has
    with pytest.raises(InvalidData, match=r"`ptrepack --complib=zlib .*packed\.h5:/ NEW\.h5:/`"):
        read_plain(path)


def test_links_out_of_the_file_are_not_followed(tmp_path: Path) -> None:
    inner = write(tmp_path / "inner.h5", np.ones((2, 2, 5), np.uint8))
    with h5py.File(tmp_path / "outer.h5", "w") as file:
        file["histograms"] = h5py.ExternalLink(str(inner), "/histograms")
    with pytest.raises(InvalidData, match="link"):
        read_plain(tmp_path / "outer.h5")


def test_a_bomb_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("histograms", shape=(4096, 4096, 4096), dtype="u2", chunks=(64, 64, 64))
        file.attrs.update({"bin_width_s": 4e-12, "wall_size_m": 1.0})
    with pytest.raises(InvalidData, match="GiB"):
        read_plain(tmp_path / "bomb.h5")
