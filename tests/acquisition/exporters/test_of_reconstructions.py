"""A reconstruction is no scan: formats of scans are refused with the way that there is."""

from pathlib import Path

import numpy as np
import pytest

from nlos.__main__ import run as cli
from nlos.acquisition.wall import WallGrid
from nlos.recon.results import write_reconstruction
from nlos.recon.volume import Reconstruction


@pytest.mark.parametrize("word", ["mat", "npz"])
def test_a_reconstruction_is_named_as_such_with_what_reads_it(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ones = np.ones((8, 8), np.float32)
    file = tmp_path / "reconstruction.h5"
    write_reconstruction(file, Reconstruction(ones, ones, WallGrid(1.0, 1.0, 8, 8), "lct", 0.1))
    assert cli(["export", str(file), "--to", word]) == 7
    said = capsys.readouterr().err
    assert f"is a reconstruction, and {word} is a format of scans" in said
    assert "h5read('reconstruction.h5', '/albedo').'" in said
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
