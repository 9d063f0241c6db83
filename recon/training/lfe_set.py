"""Reader of the LFE data set's layout (Chen et al. 2020), for those who have it: motorcycles on 256 x 256 points.

root/<shininess>/<model>/shine_<s>-rot_<x>_<y>_<z>-shift_<x>_<y>_<z>/ holds `light-<c>-<max>-<far>-<near>.hdr`, the
transient as 600 frames below one another in bins of 1 cm of path (c: 1 confocal, 2 confocal through a detector model),
`confocal-0-*.hdr`, the frontal picture, and `depth-0-*.hdr`, nearness in [0, 1], 0 where nothing is.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.radiance import read_radiance

BIN_PATH_M = 0.01
WALL_WIDTH_M = 2.0
TRAINED_MODELS = 250
LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)
Kind = Literal["confocal", "detector"]
Part = Literal["train", "test"]


@dataclass(frozen=True)
class LfeScene:
    """One folder of the set."""

    folder: Path
    model: str

    def transient(self, kind: Kind = "confocal", bins: int = 512) -> Transient:
        """The first `bins` frames as gray values; the exposure is one second everywhere.

        Raises FileNotFoundError where the folder holds no such transient, ValueError where it is not a stack of
        square frames.
        """
        path = self.file(f"light-{1 if kind == 'confocal' else 2}-*.hdr")
        gray = read_radiance(path) @ LUMINANCE
        side = gray.shape[1]
        if gray.shape[0] % side or gray.shape[0] // side < bins:
            raise ValueError(f"{path}: {gray.shape[0]} x {side} is not a stack of {bins} square frames")
        counts = gray[: bins * side].reshape(bins, side, side)
        time = TimeAxis(bins, BIN_PATH_M / SPEED_OF_LIGHT_M_PER_S)
        return Transient(counts, np.ones((side, side)), WallGrid(WALL_WIDTH_M, WALL_WIDTH_M, side, side), time)

    def picture(self, view: int = 0) -> npt.NDArray[np.float32]:
        """The rendered picture as gray values over their maximum, (256, 256)."""
        gray = read_radiance(self.file(f"confocal-{view}-*.hdr")) @ LUMINANCE
        return np.asarray(gray / max(float(gray.max()), 1e-12), dtype=np.float32)

    def nearness(self, view: int = 0) -> npt.NDArray[np.float32]:
        """1 nearest, 0 where nothing is, (256, 256)."""
        return np.clip(read_radiance(self.file(f"depth-{view}-*.hdr"))[..., 0], 0, 1)

    def file(self, pattern: str) -> Path:
        """The first file of that pattern. Raises FileNotFoundError."""
        for path in sorted(self.folder.glob(pattern)):
            return path
        raise FileNotFoundError(f"{self.folder} holds no {pattern}; is it a scene of the LFE set, fully unpacked?")


def lfe_scenes(top: Path, part: Part) -> Iterator[LfeScene]:
    """The scenes of one part of root/<shininess>: models in descending order, the first 250 to train, the others to
    test, as published. None where there is no such folder."""
    models = sorted((path for path in top.glob("*") if path.is_dir()), reverse=True)
    for model in models[:TRAINED_MODELS] if part == "train" else models[TRAINED_MODELS:]:
        for folder in sorted(model.glob("shine_*")):
            yield LfeScene(folder, model.name)
