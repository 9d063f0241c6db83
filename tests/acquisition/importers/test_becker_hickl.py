"""SDT files, put together from the vendor's structures, are read bin for bin; what is no scan is refused by name.

Bio-Formats 7.3 reads the same images from the same files, in every bin (decision 300).
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.describe import describe
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from tests.acquisition.importers.sdt_files import (
    COLLECTED_S,
    DECAY,
    FCS,
    FIFO,
    GAIN,
    IMAGE,
    STOPPED_S,
    TAC_S,
    write_sdt,
)

COUNTS = np.random.default_rng(0).poisson(3.0, (6, 5, 256)).astype(np.uint16)
IMAGES: dict[str, dict[str, Any]] = {
    "scan in": {}, "fifo image": {"kind": IMAGE, "mode": FIFO}, "before revision 15": {"old": True},
    "zipped": {"kind": IMAGE, "mode": FIFO, "zipped": True}, "check word": {"word": True},
}  # fmt: skip


@pytest.mark.parametrize("form", IMAGES)
@pytest.mark.parametrize("detectors", [1, 2])
def test_an_image_is_read_bin_for_bin_and_detectors_are_added_up(tmp_path: Path, form: str, detectors: int) -> None:
    blocks = [COUNTS, COUNTS[::-1]][:detectors]
    scan = read_any(write_sdt(tmp_path / "scan.sdt", blocks, **IMAGES[form]))
    assert np.array_equal(np.moveaxis(scan.transient.counts, 0, 2), sum(block.astype(int) for block in blocks))
    assert scan.transient.time.bin_width_s == pytest.approx(TAC_S / GAIN / 256)
    assert scan.transient.exposure_s == pytest.approx(np.full((6, 5), STOPPED_S / 30))
    assert not scan.rectified
    assert not scan.wall_known
    assert any("added up" in note for note in scan.notes) == (detectors == 2)
    assert any("assuming the 48 s of the measurement" in note for note in scan.notes)


def test_curves_are_a_row_of_points(tmp_path: Path) -> None:
    curves = [COUNTS[0, n].astype(np.uint32) * 70_000 for n in range(3)]  # beyond 16 bits
    scan = read_any(write_sdt(tmp_path / "curves.sdt", curves, DECAY, FIFO, said={"meas_mode": 0, "stop_time": 0.0}))
    assert np.array_equal(scan.transient.counts[:, 0], np.stack(curves, axis=1).astype(np.float32))
    assert scan.transient.exposure_s == pytest.approx(np.full((1, 3), COLLECTED_S))


def test_a_file_that_says_no_time_axis_takes_the_users(tmp_path: Path) -> None:
    path = write_sdt(tmp_path / "scan.sdt", [COUNTS], said={"tac_g": 0, "tac_r": 0.0})
    with pytest.raises(InvalidData, match="--bin-width-ps"):
        read_any(path)
    assert read_any(path, Given(bin_width_s=4e-12, wall_m=(2.0, 1.0))).transient.time.bin_width_s == 4e-12


def test_it_is_told_by_its_contents(tmp_path: Path) -> None:
    for suffix in (".ptu", ".h5", ".dat"):
        assert read_any(write_sdt(tmp_path / f"scan{suffix}", [COUNTS])).source_format == "SDT image"


def test_a_header_whose_check_sum_is_wrong_is_refused(tmp_path: Path) -> None:
    path = write_sdt(tmp_path / "scan.sdt", [COUNTS])
    _changed(path, 2, "<i", 43)  # where its texts begin
    with pytest.raises(InvalidData, match=r"scan.sdt: does not begin as an SDT file"):
        read_any(path)


def _changed(path: Path, at: int, layout: str, value: int) -> None:
    raw = bytearray(path.read_bytes())
    struct.pack_into(layout, raw, at, value)
    path.write_bytes(raw)


def test_what_is_no_scan_is_refused_by_name(tmp_path: Path) -> None:
    path = write_sdt(tmp_path / "fcs.sdt", [COUNTS[0, 0]], FCS, FIFO)
    with pytest.raises(InvalidData, match=r"fcs.sdt: holds no histograms of delays, but FCS_BLOCK"):
        read_any(path)
    assert "FCS_BLOCK (1, 256)" in str(describe(path)["blocks"])
    mixed = tmp_path / "mixed.sdt"
    write_sdt(mixed, [COUNTS, COUNTS[0]])
    with pytest.raises(InvalidData, match="images and curves"):
        read_any(mixed)
    unfinished = write_sdt(tmp_path / "unfinished.sdt", [COUNTS])
    _changed(unfinished, 32, "<H", 0x1111)
    with pytest.raises(InvalidData, match="never finished"):
        read_any(unfinished)
    (tmp_path / "photons.spc").write_bytes(bytes(4000))
    with pytest.raises(InvalidData, match=r"photons.spc: is a FIFO stream of Becker & Hickl.*SDT.*Photon-HDF5"):
        read_any(tmp_path / "photons.spc")
    (tmp_path / "clicks.ttbin").write_bytes(b"SITT" + bytes(4000))
    with pytest.raises(InvalidData, match=r"clicks.ttbin: is a stream of Swabian's Time Tagger.*Replay.*Flim"):
        read_any(tmp_path / "clicks.ttbin")
    (tmp_path / "other.sdt").write_bytes(b"not an SDT file" * 10)
    with pytest.raises(InvalidData, match="does not begin as an SDT file"):
        read_any(tmp_path / "other.sdt")


@pytest.mark.parametrize("keep", [0, 20, 41, 42, 300, 700, 1000, 5000, -1])
def test_truncated_files_are_refused(tmp_path: Path, keep: int) -> None:
    path = write_sdt(tmp_path / "short.sdt", [COUNTS])
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InvalidData, match=r"short\.sdt"):
        read_any(path)


@pytest.mark.parametrize("missing", [4, 512])
def test_a_curve_that_is_cut_short_is_none_with_fewer_bins(tmp_path: Path, missing: int) -> None:
    """Curves are taken as long as they are: nothing but the block's own length says that there were more. sdtfile from
    2026.10 on sees it first."""
    path = write_sdt(tmp_path / "curves.sdt", [COUNTS[0, n].astype(np.uint32) for n in range(2)], DECAY, FIFO)
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(InvalidData, match=rf"states 1024 bytes and holds {1024 - missing}|or one that is cut off"):
        read_any(path)
