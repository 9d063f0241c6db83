"""Of a file with several detectors, the photons of one: held against `ptufile`'s channels and against all of them."""

from pathlib import Path

import numpy as np
import ptufile
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.loaded import load_scan
from tests.acquisition.importers.sdt_files import write_sdt
from tests.acquisition.importers.test_becker_hickl import COUNTS
from tests.acquisition.importers.test_photon_hdf5 import write
from tests.acquisition.importers.test_picoquant import TCSPC, needs_files
from tests.command import nlos


def counted(path: Path, detector: int | None = None) -> np.ndarray:
    """(H, W, T)"""
    return np.moveaxis(read_any(path, Given(detector=detector)).transient.counts, 0, 2)


def note(scan: ImportedScan) -> str:
    return next(note for note in scan.notes if "detector" in note)


@needs_files
def test_the_detectors_of_a_point_are_parts_of_what_is_added_up() -> None:
    path = TCSPC / "picoharp_topfluorPE.pt3"
    parts = [counted(path, number) for number in (1, 2)]
    np.testing.assert_array_equal(parts[0] + parts[1], counted(path))
    assert [int(part.sum()) for part in parts] == [482_775, 490_562]
    assert (
        note(read_any(path, Given(detector=1)))
        == "photons of detector 1 alone, as given; not imported: 490,562 of detector 2"
    )
    with pytest.raises(InvalidData, match=r"--detector 3: has no photons of it; there are 482,775 of detector 1, 490"):
        read_any(path, Given(detector=3))


def two_channels(path: Path, channels: tuple[int, int]) -> np.ndarray:
    """An image of 6 x 5 points written by `ptufile`, with photons of two channels: counts (Y, X, C, T)."""
    counts = np.zeros((6, 5, max(channels) + 1, 32), np.uint8)
    drawn = np.random.default_rng(2).poisson(3.0, (6, 5, 2, 32)).astype(np.uint8)
    counts[:, :, list(channels)] = drawn
    ptufile.imwrite(path, counts, 25e-9, 25e-9 / 32, pixel_time=1e-3)
    return drawn


@pytest.mark.parametrize("channels", [(0, 1), (1, 3)])
def test_the_detectors_of_an_image_are_ptufile_s_channels(tmp_path: Path, channels: tuple[int, int]) -> None:
    path = tmp_path / "two.ptu"
    drawn = two_channels(path, channels)
    np.testing.assert_array_equal(counted(path), drawn.sum(axis=2))
    with ptufile.PtuFile(path) as ptu:
        theirs = [int(channel) for channel in ptu.active_channels]
    for place, (number, named) in enumerate(zip(channels, theirs, strict=True)):
        np.testing.assert_array_equal(counted(path, named), drawn[:, :, place], err_msg=str(number))
        assert "between lines" not in " ".join(read_any(path, Given(detector=named)).notes)
    with pytest.raises(InvalidData, match="--detector 2: has no photons of it"):
        read_any(path, Given(detector=2))


def test_the_images_of_an_sdt_are_numbered_from_0(tmp_path: Path) -> None:
    path = write_sdt(tmp_path / "two.sdt", [COUNTS, COUNTS[::-1]])
    for number, expected in enumerate((COUNTS, COUNTS[::-1])):
        np.testing.assert_array_equal(counted(path, number), expected)
    with pytest.raises(InvalidData, match="--detector 2: has no photons of it"):
        read_any(path, Given(detector=2))


def test_photons_of_photon_hdf5_are_those_of_the_detector(tmp_path: Path) -> None:
    ids = np.arange(500).astype(np.uint8) % 2
    path = write(tmp_path / "one.h5", detectors=ids)
    parts = [counted(path, number) for number in (0, 1)]
    assert [part.sum() for part in parts] == [250, 250]
    with pytest.raises(InvalidData, match="photon_data: --detector 4: has no photons of it"):
        read_any(path, Given(detector=4))


def test_formats_that_know_no_detectors_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "own.npz", histograms=np.ones((4, 4, 16), np.uint16), bin_width_s=32e-12, wall_size_m=1.0)
    with pytest.raises(InvalidData, match=r"--detector 0: .* does not say which detector saw what"):
        read_any(tmp_path / "own.npz", Given(detector=0))


def test_a_detector_is_named_on_the_command_line(tmp_path: Path) -> None:
    drawn = two_channels(tmp_path / "two.ptu", (0, 1))
    nlos(tmp_path, "import", "two.ptu", "-o", "one.h5", "--detector", "1", check=True)
    np.testing.assert_array_equal(np.moveaxis(load_scan(tmp_path / "one.h5").transient.counts, 0, 2), drawn[:, :, 1])
    from_file = nlos(tmp_path, "reconstruct", "two.ptu", "--detector", "1", "--wall-size-m", "1", "--rectified")
    assert (from_file.returncode, "photons of detector 1 alone" in from_file.stderr) == (0, True)
    for verb in ("reconstruct", "calibrate"):
        again = nlos(tmp_path, verb, "one.h5", "--detector", "1", "--overwrite")
        assert (again.returncode, "is a recording: it knows" in again.stderr) == (7, True)
