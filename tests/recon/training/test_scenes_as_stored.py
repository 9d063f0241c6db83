"""Scenes on disk that say where their columns, rows and first bin lie: histograms and truth stay with each other."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scene_files import write_scene
from nlos.recon.training.scenes_on_disk import fingerprint, read_scene

WALL, TIME = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(tmp_path / "one.h5", "stars", 0, WALL, TIME)
    return tmp_path / "one.h5"


def test_the_truth_is_turned_round_as_its_histograms_are(scene: Path) -> None:
    plain, shown = read_scene(scene), fingerprint(scene)
    with h5py.File(scene, "a") as file:
        for name in file:
            file[name][...] = file[name][...][::-1, ::-1]
        file["x_m"], file["y_m"] = WALL.x_m()[::-1], WALL.y_m()[::-1]
    turned = read_scene(scene)
    for name in ("light", "intensity", "albedo", "depth_m", "coverage"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(plain, name), err_msg=name)
    assert fingerprint(scene) == shown


@pytest.mark.parametrize("late", [20, 20.25])
def test_a_record_that_begins_after_time_0_keeps_its_times(scene: Path, late: float) -> None:
    plain = read_scene(scene).light
    assert not plain[:21].any()
    with h5py.File(scene, "a") as file:
        held = file["transient"][..., 20:]
        del file["transient"]
        file["transient"] = held
        file.attrs["offset_s"] = late * TIME.bin_width_s
    seen = read_scene(scene)
    assert seen.time.bins == 128 + (late > 20)
    middle = np.tensordot(np.arange(seen.time.bins), seen.light, 1) - np.tensordot(np.arange(128), plain, 1)
    np.testing.assert_allclose(middle, (late - 20) * plain.sum(axis=0), atol=1e-3)


def test_counts_are_not_shared_between_bins_nor_put_behind_endless_ones(scene: Path) -> None:
    with h5py.File(scene, "a") as file:
        file["histograms"] = file["counts_p20"][...]
        del file["transient"]
        file.attrs["offset_s"] = 2.5 * TIME.bin_width_s
    with pytest.raises(ValueError, match=r"begins 2.5 bins after time 0 \(offset_s\).* whole number"):
        read_scene(scene)
    with h5py.File(scene, "a") as file:
        file.attrs["offset_s"] = 1e-3
    with pytest.raises(ValueError, match=r"one\.h5: its record of 128 bins begins .* no more than it has"):
        read_scene(scene)
