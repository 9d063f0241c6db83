"""A scan plan: wall, time axis and every visit in order, as one frozen value that iterates over `ScanPoint`."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.budget import Budget
from nlos.acquisition.planning.ordering import strips
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.sample import ScanPoint
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import HistogramAxis, StopAtCounts

MOST_PARTS = 64
"""Of interleaved frames: after so many the same points come again, if ever."""
BLOCK = 4096
"""Points that are made together while a plan is gone through."""


def _kept(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same numbers, which nobody changes: a copy of what its caller may still write to."""
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """What to measure, in which order, for how long. A point's number is its place in this order, from 0.

    Passes are frames: the same or other points of the wall at another time, each pass on its own. But with
    `revisit_below`, every later pass visits the first one's points in the same order, but takes only those whose
    histograms of the passes before hold fewer photons; the plan lists them all, so that numbers and seeds do not
    depend on what was measured. With a `budget` the points are candidates: a scan takes them, in this order or in one
    that is decided on the way, until the next in this order does not fit into the time that is left.
    """

    wall: WallGrid
    axis: HistogramAxis
    positions: Positions
    dwell_s: npt.NDArray[np.float64]  # (N,)
    pass_: npt.NDArray[np.int32]  # (N,)
    stop: StopAtCounts | None = None
    revisit_below: int | None = None
    within_px: float | None = None
    """The mirror may be kept moving along lines where that keeps the beam within this many steps of a line of each
    point; None: it settles on points."""
    budget: Budget | None = None
    """None: every point is taken."""
    until_stopped: bool = False
    """Its frames are as many as come until somebody ends the film, which is then a plan of those (`ended_after`)."""

    def __post_init__(self) -> None:
        if not len(self.positions) == len(self.dwell_s) == len(self.pass_):
            raise ValueError(
                f"a plan of {len(self.positions)} positions has {len(self.dwell_s)} dwells and {len(self.pass_)} passes"
            )
        if len(self.positions) == 0:
            raise ValueError("the plan has no points")
        if not (np.isfinite(self.dwell_s).all() and (self.dwell_s > 0).all()):
            raise ValueError("every dwell must be above 0")
        if self.revisit_below is not None and len(self) % self.first_pass:
            raise ValueError(
                f"a plan that returns needs whole passes; {len(self)} is not a multiple of {self.first_pass}"
            )
        places = Positions(*(_kept(getattr(self.positions, name)) for name in ("row", "col", "x_m", "y_m")))
        for name, value in (("positions", places), ("dwell_s", _kept(self.dwell_s)), ("pass_", _kept(self.pass_))):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, number: int) -> ScanPoint:
        if not 0 <= number < len(self):
            raise IndexError(f"point {number} of a plan of {len(self)}")
        row, col = int(self.positions.row[number]), int(self.positions.col[number])
        return ScanPoint(
            number=number,
            row=row if row >= 0 else None,
            col=col if col >= 0 else None,
            x_m=float(self.positions.x_m[number]),
            y_m=float(self.positions.y_m[number]),
            dwell_s=float(self.dwell_s[number]),
            pass_=int(self.pass_[number]),
        )

    def __iter__(self) -> Iterator[ScanPoint]:
        for first in range(0, len(self), BLOCK):
            yield from self.points(first, first + BLOCK)

    def points(self, first: int, end: int) -> list[ScanPoint]:
        """The points from number `first` up to `end`, or to the last one."""
        columns = (column[first:end].tolist() for column in self.columns().values())
        return [
            ScanPoint(number, row if row >= 0 else None, col if col >= 0 else None, x_m, y_m, dwell_s, pass_)
            for number, (row, col, x_m, y_m, dwell_s, pass_) in enumerate(zip(*columns, strict=True), first)
        ]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ScanPlan) and self.digest() == other.digest()

    def __hash__(self) -> int:
        return hash(self.digest())

    @property
    def dwell_total_s(self) -> float:
        """Time with the gate open, all passes, nothing stopped early; of candidates those that come unless advised."""
        return float(self.dwell_s[self.expected()].sum())

    @property
    def first_pass(self) -> int:
        """How many points pass 0 has."""
        return int(np.count_nonzero(self.pass_ == 0))

    @property
    def frames(self) -> int:
        """How many times the pattern is scanned, each a frame of its own: passes that do not depend on one another."""
        return 1 if self.revisit_below is not None or self.budget is not None else int(self.pass_.max()) + 1

    @property
    def frame_points(self) -> npt.NDArray[np.int64]:
        """How many points each frame has, (F,); a last one that a film was ended in as many as the same part of the
        points had before."""
        points = np.bincount(self.pass_, minlength=self.frames) if self.frames > 1 else np.array([len(self)])
        if (cycle := self.cycle) < len(points):
            points[-1] = max(points[-1], points[-1 - cycle])
        return points

    def ended_after(self, points: int) -> "ScanPlan":
        """What the film's plan is once it was ended after so many points."""
        return replace(self.only(np.arange(points)), until_stopped=False)

    @property
    def first_round(self) -> int:
        """How many points it takes until all of the wall came once."""
        return int(np.count_nonzero(self.pass_ < self.cycle))

    @property
    def most_samples(self) -> int:
        """How many samples a recording of it holds, at most where some points are only candidates."""
        return len(self) if self.budget is None else self.budget.most(self.budget.costs_us(self.dwell_s))

    @property
    def most_together(self) -> int:
        """How many points are armed at once, at most."""
        return len(self) if self.budget is None or self.budget.after_first else self.budget.batch

    def left_us(self, taken: Collection[int]) -> int:
        """What is left of the budget. Raises `ValueError` for a plan without one."""
        if self.budget is None:
            raise ValueError("a plan without a budget takes all of its points")
        return self.budget.total_us - int(self.budget.costs_us(self.dwell_s[list(taken)]).sum())

    @property
    def cycle(self) -> int:
        """After how many frames the same points come again, or some of them if a film was ended there."""
        if (frames := self.frames) == 1:
            return 1
        first = self._places_of(0)
        for frame in range(1, min(frames, MOST_PARTS + 1)):
            places = self._places_of(frame)
            if places == first or (frame == frames - 1 and places < first):
                return frame
        return frames

    def _places_of(self, frame: int) -> set[tuple[float, float]]:
        of = self.pass_ == frame
        return set(zip(self.positions.x_m[of].tolist(), self.positions.y_m[of].tolist(), strict=True))

    def pending(self, photons: Mapping[int, int], first_pass_cut: bool = False) -> list[int]:
        """The numbers still to take, in order; `photons` is what was taken: point number -> counts in its histogram.
        Of the passes only the first that is not finished is listed where later ones depend on it, with
        `first_pass_cut` the second, of what the first came to; of candidates those that come if nobody says otherwise.
        """
        if first_pass_cut and self.revisit_below is not None:
            photons = {**dict.fromkeys(range(self.first_pass), self.revisit_below), **photons}
        open_ = [number for number in range(len(self)) if number not in photons]
        if self.budget is not None:
            return open_[: self.budget.first(self.budget.costs_us(self.dwell_s[open_]), self.left_us(photons))]
        if self.revisit_below is None or not open_:
            return open_
        first_pass = self.first_pass
        if open_[0] < first_pass:
            return [number for number in open_ if number < first_pass]
        sums = [0] * first_pass
        for number, count in photons.items():
            sums[number % first_pass] += count
        short = [number for number in open_ if sums[number % first_pass] < self.revisit_below]
        return [number for number in short if self.pass_[number] == self.pass_[short[0]]]

    def expected(self) -> npt.NDArray[np.intp]:
        """The numbers that a scan takes if nobody says otherwise, in order; candidates as they come batch by batch."""
        if self.budget is None:
            return np.arange(len(self))
        numbers = np.array(self.pending({}), dtype=np.intp)
        if self.budget.after_first:
            return numbers
        batches = [numbers[first : first + self.budget.batch] for first in range(0, len(numbers), self.budget.batch)]
        return np.concatenate([self.on_path(batch) for batch in batches])

    def on_path(self, numbers: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """The same numbers in strips, those of one pass together."""
        x_m, y_m, pass_ = self.positions.x_m[numbers], self.positions.y_m[numbers], self.pass_[numbers]
        parts = [np.flatnonzero(pass_ == each) for each in np.unique(pass_)]
        return np.concatenate([numbers[part[strips(x_m[part], y_m[part])]] for part in parts])

    def only(self, numbers: npt.NDArray[np.intp]) -> "ScanPlan":
        """A plan of some of its points, numbered anew: to forecast with."""
        return replace(
            self, positions=self.positions.take(numbers), dwell_s=self.dwell_s[numbers], pass_=self.pass_[numbers]
        )

    def on_axis(self, axis: HistogramAxis) -> "ScanPlan":
        """The same points over another time axis; a window that ends points early keeps its times."""
        old, stop = self.axis, self.stop
        if stop is not None:
            first, end = (
                round((old.offset_s + each * old.bin_width_s - axis.offset_s) / axis.bin_width_s)
                for each in (stop.first_bin, stop.end_bin)
            )
            stop = replace(stop, first_bin=max(first, 0), end_bin=min(max(end, first + 1), axis.bins))
        return replace(self, axis=axis, stop=stop)

    def digest(self) -> str:
        """SHA-256 over everything that the plan says: equal digests are equal plans."""
        digest = hashlib.sha256(json.dumps(self.scalars(), sort_keys=True).encode())
        for array in self.columns().values():
            digest.update(array.tobytes())
        return digest.hexdigest()

    def scalars(self) -> dict[str, Any]:
        """Everything that is not one of `columns`, as JSON has it; `from_parts` is the way back."""
        found: dict[str, Any] = {
            "wall": asdict(self.wall),
            "axis": asdict(self.axis),
            "stop": asdict(self.stop) if self.stop else None,
            "revisit_below": self.revisit_below,
        }
        later = {
            "within_px": self.within_px,
            "budget": asdict(self.budget) if self.budget else None,
            "until_stopped": self.until_stopped or None,
        }
        return {**found, **{name: value for name, value in later.items() if value is not None}}

    @classmethod
    def from_parts(cls, scalars: Mapping[str, Any], columns: Mapping[str, npt.NDArray[Any]]) -> "ScanPlan":
        """The plan with these `scalars` and `columns`. Raises `ValueError`, `KeyError` or `TypeError` for others."""
        said = dict(scalars)
        return cls(
            wall=WallGrid(**said.pop("wall")),
            axis=HistogramAxis(**said.pop("axis")),
            positions=Positions(columns["row"], columns["col"], columns["x_m"], columns["y_m"]),
            dwell_s=columns["dwell_s"],
            pass_=columns["pass"],
            stop=StopAtCounts(**stop) if (stop := said.pop("stop")) else None,
            budget=Budget(**budget) if (budget := said.pop("budget", None)) else None,
            **said,
        )

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """The points as arrays of length N, keyed by the names that a recording stores them under."""
        return {
            "row": self.positions.row,
            "col": self.positions.col,
            "x_m": self.positions.x_m,
            "y_m": self.positions.y_m,
            "dwell_s": self.dwell_s,
            "pass": self.pass_,
        }
