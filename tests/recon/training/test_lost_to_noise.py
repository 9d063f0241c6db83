"""What noise costs is measured as `nlos evaluate` measures, each method at its best snr, and noise costs something."""

from pathlib import Path

import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.evaluate import evaluate
from nlos.recon.training.scene_files import write_scene
from nlos.recon.truth_scenes import find_scenes, transient_of
from studies.added_noise import with_noise
from studies.lost_to_noise import psnr

KINDS = ("signs", "shelves")


def test_a_tuned_method_has_the_psnr_that_an_evaluation_gives_it_and_loses_from_noise(tmp_path: Path) -> None:
    for number, kind in enumerate(KINDS):
        write_scene(tmp_path / f"{kind}.h5", kind, number, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    scenes = list(find_scenes([tmp_path], lambda _: None))
    clean = [transient_of(scene, "transient") for scene in scenes]
    found = psnr("lct", scenes, clean)
    told = evaluate([tmp_path], ["lct"], ["transient"], say=lambda _: None)
    assert found[0] == pytest.approx([row.psnr for row in told.rows])
    noisy = [with_noise(each, 100.0, seed) for seed, each in enumerate(clean)]
    assert psnr("lct", scenes, noisy).mean() < found.mean()
