"""What a user says about a file that does not say it, or not rightly: it goes before what the file says."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import NO_WALL, ImportedScan
from nlos.acquisition.importers.missing_direct import SAID

_OF_DETECTORS = ("PTU", "PicoHarp PT3", "HydraHarp HT3", "TimeHarp T3R", "SDT image", "Photon-HDF5")
"""Formats whose photons are of detectors that are told apart."""
_LETTERS = {"T": "T", "Y": "Y", "H": "Y", "X": "X", "W": "X", "N": "N"}


@dataclass(frozen=True)
class Given:
    """None: nothing was said."""

    wall_m: tuple[float, float] | None = None
    """Width and height."""
    bin_width_s: float | None = None
    axes: str | None = None
    """The order of the histograms' axes: the letters T, Y, X (or T, H, W), or N and T for free positions."""
    rectified: bool | None = None
    """Whether time 0 is the wall and direct light is gone."""
    detector: int | None = None
    """Photons of this one alone, by the number that the file has for it."""

    def ordered(self, counts: npt.NDArray[Any], place: str, told: bool = False) -> npt.NDArray[Any]:
        """Histograms as [H, W, T] or [N, T]. `told`: other arrays of the file have shown the order to be that.

        Raises `InvalidData`, naming `place`, where the order is not `axes`' or looks like another.
        """
        expected = "NT" if counts.ndim == 2 else "YXT"
        if self.axes is not None:
            named = "".join(_LETTERS.get(letter, letter) for letter in self.axes.upper())
            if sorted(named) != sorted(expected):
                raise InvalidData(
                    f"{place}: has shape {counts.shape}; --axes {self.axes} does not name its {counts.ndim} axes. Use "
                    f"the letters of {expected} in the order in which they are stored."
                )
            return np.transpose(counts, [named.index(letter) for letter in expected])
        if counts.ndim == 3 and not told and (axis := time_seems_at(counts.shape)) is not None:
            which, letters = ("first", "TYX") if axis == 0 else ("second", "YTX")
            raise InvalidData(
                f"{place}: has shape {counts.shape}, where [H, W, T] is expected: is time the {which} axis? "
                f"Store it as [H, W, T] if so; `nlos reconstruct` and `nlos import` also take --axes {letters}, "
                f"{letters[::-1] if axis else 'TXY'} where x comes before y (as in HDF5 that MATLAB or Fortran wrote, "
                "whose axes are all reversed), and --axes YXT if it is [H, W, T] as it is."
            )
        return counts

    def beside(self, values: npt.NDArray[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """A number for each point of a grid of `shape` (H, W), which a file has in the order of its histograms or
        already as (H, W); of a square grid it is taken for the former."""
        named = "".join(_LETTERS.get(letter, letter) for letter in (self.axes or "").upper())
        x_first = "X" in named and "Y" in named and named.index("X") < named.index("Y")
        return values.T if x_first and values.shape == shape[::-1] else values

    def places(self, key: str, values: npt.NDArray[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """`x_m` or `y_m` (`key`) of each point of a grid of `shape` (H, W), as `beside`; of a square grid they tell
        themselves along which axis they do not change."""
        turned = self.beside(values, shape)
        if values.ndim != 2 or shape[0] != shape[1]:
            return turned
        same = 0 if key == "x_m" else 1
        return turned if np.ptp(turned, axis=same).max() <= np.ptp(values, axis=same).max() else values

    def other_bins(self, stored_s: object) -> list[str]:
        """The note of bins that are given in place of what a file says; none where it says the same, or nothing."""
        told = np.asarray(stored_s)
        if self.bin_width_s is None or told.size != 1 or told.dtype.kind not in "uif" or told == self.bin_width_s:
            return []
        return [f"bins of {self.bin_width_s * 1e12:g} ps, as given ({float(told.item()) * 1e12:g} ps in the file)"]

    def applied(self, scan: ImportedScan) -> ImportedScan:
        """The scan with what was said in place of what the file said, and a note of each."""
        notes = list(scan.notes)
        if self.bin_width_s is not None and self.bin_width_s != scan.held.time.bin_width_s:
            time = replace(scan.held.time, bin_width_s=self.bin_width_s)
            notes += self.other_bins(scan.held.time.bin_width_s)
            scan = replace(scan, held=replace(scan.held, time=time))
        if self.wall_m is not None:
            scan = scan.on_wall(*self.wall_m)
            notes = [note for note in notes if not note.startswith(NO_WALL)]
            notes.append(f"a wall of {self.wall_m[0]:g} x {self.wall_m[1]:g} m, as given{_pitches(scan)}")
        if self.rectified is not None and self.rectified != scan.rectified:
            notes.append(f"{'rectified' if self.rectified else 'raw'}, as given")
            cut = scan.direct_cut_bins if self.rectified else 0
            scan = replace(scan, rectified=self.rectified, direct_cut_bins=cut)
        if self.rectified is not None and scan.no_direct_light:
            notes = [note for note in notes if note != SAID]
            scan = replace(scan, no_direct_light=False)
        return replace(scan, notes=tuple(notes))

    def refuse_axes(self, name: str, scan: ImportedScan) -> None:
        """Raises `InvalidData` where axes were named for a format that has one order only."""
        if (
            self.axes is not None
            and not scan.source_format.startswith(("plain", "NPZ", "NumPy", "MATLAB export"))
            and (not scan.source_format.endswith(".mat"))
        ):
            raise InvalidData(f"{name}: --axes: {scan.source_format} has an order of its own; leave --axes out")

    def refuse_detector(self, name: str, scan: ImportedScan) -> None:
        """Raises `InvalidData` where a detector was named for a format that does not tell them apart."""
        if self.detector is not None and not scan.source_format.startswith(_OF_DETECTORS):
            raise InvalidData(
                f"{name}: --detector {self.detector}: {scan.source_format} does not say which detector saw what; leave "
                "--detector out"
            )


NOTHING = Given()


def _pitches(scan: ImportedScan) -> str:
    """How far points are apart, where that is not the same in x and in y."""
    if scan.points is not None:
        return ""
    wall = scan.transient.wall
    in_x, in_y = wall.width_m / wall.cols, wall.height_m / wall.rows
    if abs(in_x - in_y) < 0.01 * max(in_x, in_y):
        return ""
    return f": points {in_x * 100:.3g} cm apart in x and {in_y * 100:.3g} cm in y (as far apart in both: WxH)"


def put_there(option: str) -> str:
    """What to do about a file that does not say something, whichever command meets it."""
    return f"Put it into the file; `nlos reconstruct` and `nlos import` also take {option}"


def time_seems_at(shape: tuple[int, ...]) -> int | None:
    """Which axis of three seems to be time where that is not the last. Grids are square more often than not, and no
    grid is four times as high or wide as there are time bins."""
    first, second, third = shape
    if (second == third != first) or (first >= 4 * third and first >= 4 * second):
        return 0
    if (first == third and second >= 2 * first) or (second >= 4 * third and second >= 4 * first):
        return 1
    return None
