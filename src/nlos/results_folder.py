"""The folder that results go to: what of them is kept there, and that nothing is replaced unasked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nlos.recon.results import NAMES
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
        """Raises `FileExistsError` where one of `names`, by default those of a reconstruction, is there and may not be
        replaced, and as `check_writable` does."""
        check_writable(self.path)
        if self.overwrite:
            return
        for name in names or ((*NAMES, "view3d.html") if self.html else NAMES):
            if (self.path / name).exists():
                raise FileExistsError(f"{self.path / name}: exists. Choose another folder with -o, or use --overwrite.")
