"""A scan that was recorded too briefly at some points: how deep its picture reaches, and what is not in it."""

import re
from pathlib import Path

import h5py
import pytest

from nlos.__main__ import run
from tests.calibration.conftest import make_raw_scan


@pytest.mark.parametrize("bins", [None, 230])
def test_light_behind_the_shortest_record_is_said(
    bins: int | None, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scan = make_raw_scan(hidden_counts=300, delay_s=-12e-9)
    ends = None if bins is None else int(scan.arrival_bins.max()) + bins
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file["histograms"] = scan.counts.reshape(16, 16, -1)[..., :ends]
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = scan.bin_width_s, 2.0
        file.attrs["rectified"] = False
    assert run(["reconstruct", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "out")]) == 0
    said = capfd.readouterr().err
    found = re.search(r"behind (1\.\d+) m nothing is looked at: .* ([0-9]+) % of the light came later", said)
    assert (found is None) == (bins is None)
    if found is not None:
        assert float(found[1]) == pytest.approx(1.10, abs=0.01)
        assert 5 < int(found[2]) < 95
