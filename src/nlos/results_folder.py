"""The folder that results go to: what of them is kept there, and that nothing is replaced unasked."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nlos.recon.results import EVERYTHING
from nlos.writable import check_writable


@dataclass(frozen=True)
class ResultsFolder:
    """`depth_m` (nearest, farthest) limits what is kept; `html` adds view3d.html."""

    path: Path
    volume: bool = True
    html: bool = False
    depth_m: tuple[float, float] | None = None
    overwrite: bool = False

    def check(self, names: Sequence[str] | None = None) -> None:
        """Raises `FileExistsError` where one of `names`, by default all that a reconstruction has, is there and may
        not be replaced, a link to nothing neither, and as `check_writable` does."""
        check_writable(self.path)
        if self.overwrite:
            return
        asked_for = {"view3d.html": self.html, "slices.png": self.volume}
        for name in names or (name for name in EVERYTHING if asked_for.get(name, True)):
            if os.path.lexists(self.path / name):
                raise FileExistsError(f"{self.path / name}: exists. Choose another folder with -o, or use --overwrite.")
