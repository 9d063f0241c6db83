"""Films from the command line: scanned, told frame by frame, and reconstructed one frame at a time."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

import nlos as library
from nlos.acquisition.errors import InvalidData
from tests.nlos.conftest import SMALL, Nlos


def test_a_film_is_scanned_told_and_reconstructed_by_frame(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "film.yaml").write_text(SMALL + "frames: 3\n")
    done = nlos("scan", "film.yaml", "-o", "film.h5")
    assert done.returncode == 0, done.stderr
    told = json.loads(nlos("info", "film.h5", "--json").stdout)
    assert told["frames"].startswith("3 of 3 complete")
    table = told["frame table"]
    assert [row["points"] for row in table] == [16, 16, 16]
    assert all(later["start_s"] >= earlier["end_s"] for earlier, later in itertools.pairwise(table))
    assert all(row["pulses"] == pytest.approx(row["live_s"] * 10e6) for row in table)
    whole = library.load(tmp_path / "film.h5")
    parts = [library.load(tmp_path / "film.h5", frame=frame) for frame in range(3)]
    assert np.array_equal(np.sum([part.counts for part in parts], axis=0), whole.counts)
    assert len({part.counts.tobytes() for part in parts}) == 3
    with pytest.raises(InvalidData, match="frame 3: the recording has 3, from 0 to 2"):
        library.load(tmp_path / "film.h5", frame=3)
    done = nlos("reconstruct", "film.h5", "--frame", "1", "-o", "one")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "one" / "reconstruction.h5").is_file()
