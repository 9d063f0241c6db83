"""Differences between two trainings, paired over scenes and seeds, with the error that they have."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

Figures = npt.NDArray[np.float64]  # (seeds, scenes); NaN where a scene has none
TOLD = 2.0  # errors, of very many scenes and seeds
SURE = 0.95
"""Of differences that are nothing, about so many are not told from it; with two seeds that differ much 0.89."""


@dataclass(frozen=True)
class Difference:
    """Mean of a figure less the same of another training, and its standard error over seeds and scenes."""

    mean: float
    error: float
    seeds: int
    freedom: float = math.inf
    """Degrees that the error has: with few seeds it may be far too small by chance."""

    @property
    def told(self) -> bool:
        """Whether it is more than chance, from more than one seed."""
        return self.seeds > 1 and self.beyond_chance

    @property
    def beyond_chance(self) -> bool:
        """Whether it lies above so many errors as Student's distribution has at `SURE`, two and more; of one seed
        that is chance over scenes alone."""
        return abs(self.mean) > self.error * float(scipy.stats.t.ppf((1 + SURE) / 2, self.freedom))

    def __str__(self) -> str:
        return f"{self.mean:+.2f} ± {self.error:.2f}"


def of_scenes(
    rows: Iterable[Mapping[str, Any]], scenes: Iterable[str], method: str, condition: str, figure: str
) -> Figures:
    """One figure of one method, (1, scenes) in the order of the scenes; NaN where a scene has none."""
    known = {row["scene"]: row[figure] for row in rows if (row["method"], row["condition"]) == (method, condition)}
    values = [known.get(scene) for scene in scenes]
    return np.array([[np.nan if value is None else value for value in values]], dtype=np.float64)


def difference(row: Figures, other: Figures) -> Difference:
    """`row` less `other`, seed by seed and scene by scene; seeds that one of them lacks are not used.

    Scenes are drawn for both alike and so are seeds: the variance of the mean is that of the seeds' means over the
    seeds plus that of the scenes' means over the scenes, with the degrees of freedom of such a sum (Satterthwaite
    1946). With one seed the first is not known and the error too small.
    """
    seeds = min(len(row), len(other))
    paired = row[:seeds] - other[:seeds]
    paired = paired[:, np.isfinite(paired).any(axis=0)]
    known = np.nanmean(paired, axis=0)
    variance = float(known.var(ddof=1)) / len(known) if len(known) > 1 else math.nan
    unsure = variance**2 / (len(known) - 1) if len(known) > 1 else math.nan
    if seeds > 1:
        of_seeds = float(np.nanmean(paired, axis=1).var(ddof=1)) / seeds
        variance, unsure = variance + of_seeds, unsure + of_seeds**2 / (seeds - 1)
    freedom = variance**2 / unsure if unsure > 0 else math.inf
    return Difference(float(known.mean()), math.sqrt(variance), seeds, freedom)
