"""Every scan file that ships, stopped anywhere, times every method: a finite picture, or a refusal in words."""

import os
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData as RecordingInvalid
from nlos.acquisition.recording.recording import Recording
from nlos.calibration.errors import InvalidData as CannotCalibrate
from nlos.chain import calibrate_scan
from nlos.configs.load import names
from nlos.live.so_far import empty_scan, gathering_for, scan_of
from nlos.loaded import LoadedScan
from nlos.recon.errors import ReconError
from nlos.recon.methods import catalogue
from nlos.recon.reconstruct import reconstruct
from tests.command import nlos

SCANS, METHODS = names("scan"), sorted(catalogue())
SHARES = (0.01, 0.1, 1.0)
QUICK: dict[str, dict[str, object]] = {"gradient_descent": {"iterations": 2}}
WHOLE = os.environ.get("NLOS_SOAK") == "1"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Scan files already taken on the simulated bench, by name; filled as they are asked for."""
    return {"": tmp_path_factory.mktemp("scans")}


def taken(runs: dict[str, Path], name: str) -> Path:
    """The complete recording of a scan file that ships."""
    if name not in runs:
        runs[name] = runs[""] / f"{name}.h5"
        nlos(runs[""], "scan", name, "-o", str(runs[name]), check=True)
    return runs[name]


def first_of(run: Path, share: float) -> LoadedScan:
    """What a recording that was stopped after `share` of its samples is loaded as."""
    with Recording.open(run) as recording:
        plan = recording.plan
        samples = list(islice(recording.samples(), max(1, round(share * len(plan)))))
        so_far = gathering_for(plan)
        for sample in samples:
            so_far.add(sample)
        return scan_of(empty_scan(recording), so_far)


def finite_or_refused(scan: LoadedScan, method: str) -> str:
    """ "seen", or the sentence that says why not; fails where the picture is not finite."""
    try:
        transient = calibrate_scan(scan)
        done = reconstruct(transient, method, QUICK.get(method, {}))
    except (ReconError, CannotCalibrate, RecordingInvalid) as refusal:
        why = str(refusal)
    else:
        why = "seen"
        assert np.isfinite(done.albedo).all()
        assert not np.isinf(done.depth_m).any()
        assert done.volume is None or np.isfinite(done.volume.albedo).all()
    assert why == "seen" or (len(why) > 20 and "not finite" not in why)
    return why


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("name", "share"), [("sparse", 1.0), ("five_by_five", 0.01), ("circle", 0.1)])
def test_nano_sees_what_a_stopped_scan_holds(runs: dict[str, Path], name: str, share: float) -> None:
    seen = finite_or_refused(first_of(taken(runs, name), share), "nano")
    assert share < 1 or seen == "seen"


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_sees_points_on_and_off_the_grid(runs: dict[str, Path], method: str) -> None:
    finite_or_refused(first_of(taken(runs, "five_by_five"), 0.1), method)
    finite_or_refused(first_of(taken(runs, "circle"), 1.0), method)


@pytest.mark.soak
@pytest.mark.skipif(not WHOLE, reason="the whole table takes a quarter of an hour: make soak")
@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("name", SCANS)
def test_every_method_sees_every_scan(runs: dict[str, Path], name: str, share: float) -> None:
    scan = first_of(taken(runs, name), share)
    for method in METHODS:
        finite_or_refused(scan, method)
