"""Scenes of the kinds that training never sees, written as files that `nlos evaluate --data` reads.

`python -m nlos.recon.training.scene_files runs/held_out`
"""

import sys
from pathlib import Path

import numpy as np

from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import front_view, kind_names, make_scene, surfels
from nlos.recon.training.visibility import visibility

WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)
PEAK_COUNTS = (20, 5, 1)
BACKGROUND_SHARE = 0.02
SEED = 77


def write_scene(path: Path, kind: str, index: int, wall: WallGrid = WALL, time: TimeAxis = TIME) -> None:
    """One held-out scene: the noiseless `transient` [H, W, T] of maximum 1, counts at three exposures, and the truth.

    `counts_pN` has a mean peak of N counts and a background of 2 % of that a bin. Light is rendered with shadows.
    """
    scene = make_scene(SEED, index, wall, held_out=True, kinds=(kind,))
    view, rng = front_view(scene, wall), np.random.default_rng((SEED, index, 1))
    pieces = surfels(scene, rng)
    light = render(pieces, wall, time, seen=visibility(scene, pieces, wall)).numpy()
    light = np.moveaxis(light, 0, 2) / light.max()
    with written_hdf5(path) as file:
        file.attrs.update({"bin_width_s": time.bin_width_s, "rectified": True, "scene": path.stem, "kind": scene.kind})
        file.attrs["wall_size_m"] = [wall.width_m, wall.height_m]
        file.attrs["provenance"] = f"recon.training.scene_files, seed {SEED}, scene {index} of kind {kind}"
        file.create_dataset("transient", data=light.astype(np.float32), compression=4, shuffle=True)
        for peak in PEAK_COUNTS:
            scale = peak / light.max(axis=2).mean()
            counts = np.random.default_rng((SEED, index, 2, peak)).poisson(scale * light + BACKGROUND_SHARE * peak)
            stored = file.create_dataset(f"counts_p{peak}", data=counts.astype(np.uint16), compression=4, shuffle=True)
            stored.attrs.update({"mean_peak_counts": peak, "background_per_bin": BACKGROUND_SHARE * peak})
        for name, values in (
            ("gt_intensity", view.intensity),
            ("gt_albedo", view.albedo),
            ("gt_depth", view.depth_m),
            ("gt_mask", view.mask.astype(np.uint8)),
            ("gt_coverage", view.coverage),
        ):
            file.create_dataset(name, data=values)


def write_all(folder: Path, each: int = 1) -> list[Path]:
    """`each` scenes of every held-out kind as folder/KIND_INDEX.h5; files already there are left."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{kind}_{index}.h5" for kind in kind_names(held_out=True) for index in range(each)]
    for path in paths:
        if not path.exists():
            kind, _, index = path.stem.partition("_")
            partial = path.with_suffix(".partial")
            write_scene(partial, kind, int(index))
            partial.replace(path)
    return paths


if __name__ == "__main__":
    for written in write_all(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1):
        print(written)
