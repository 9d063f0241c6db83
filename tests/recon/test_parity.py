"""Under `conventions=authors` the volumes are those of the methods' own programs; under `physical` the same picture."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.transient import Transient
from nlos.recon.reconstruct import reconstruct

SHARED = Path(__file__).parents[2].parent / "shared" / "data"
pytestmark = pytest.mark.skipif(not SHARED.exists(), reason="../shared with measured scenes is not here")
SCENES = ("otoole_s_u", "otoole_resolution_40cm")
AS_PUBLISHED: dict[str, object] = {"conventions": "authors", "falloff": 2, "bin_width_ps": 16}


def cut_scene(name: str) -> Transient:
    scan = read_plain(SHARED / "real" / f"{name}.h5")
    counts = scan.transient.counts.copy()
    counts[: scan.direct_cut_bins] = 0
    return replace(scan.transient, counts=counts)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    ("method", "dataset", "allowed"), [("lct", "lct", 1e-5), ("fk", "fk", 1e-5), ("phasor", "phasor_lightcone", 2e-4)]
)
def test_volumes_match_the_published_programs(scene: str, method: str, dataset: str, allowed: float) -> None:
    with h5py.File(SHARED / "peers" / f"{scene}.h5") as file:
        theirs, parameters = file[dataset][()], json.loads(file.attrs["params"])
    settings = {**AS_PUBLISHED, "snr": parameters["lct_snr"]}
    done = reconstruct(cut_scene(scene), method, settings)
    assert done.volume is not None
    assert np.linalg.norm(done.volume.albedo - theirs) <= allowed * np.linalg.norm(theirs)
    assert done.volume.depths_m[100] == pytest.approx(100 * parameters["depth_m_per_bin"])


@pytest.mark.parametrize("scene", SCENES)
def test_the_physical_picture_is_the_same_scene(scene: str) -> None:
    with h5py.File(SHARED / "peers" / f"{scene}.h5") as file:
        theirs = file["lct"][()].max(0)
    done = reconstruct(cut_scene(scene), "lct", {"falloff": 2, "snr": 0.8, "bin_width_ps": 16})
    assert np.corrcoef(done.albedo.ravel(), theirs.ravel())[0, 1] >= 0.97


def test_the_authors_conventions_alone_mean_their_bin_width_and_snr() -> None:
    with h5py.File(SHARED / "peers" / "otoole_s_u.h5") as file:
        theirs = file["lct"][()]
    done = reconstruct(cut_scene("otoole_s_u"), "lct", {"conventions": "authors", "falloff": 2})
    assert done.volume is not None
    assert np.linalg.norm(done.volume.albedo - theirs) <= 1e-5 * np.linalg.norm(theirs)
