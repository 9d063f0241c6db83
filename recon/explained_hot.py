"""Points of the wall that outshine all others, as hot pixels do: named where no picture comes of the scan."""

import numpy as np

from nlos.acquisition.transient import Transient

HOT = 10.0
"""Times the counts per second of the middle point."""
FEW = 0.02
"""Of the points, at most."""
MOST = 0.5
"""Of all counts, at least."""
FEWEST = 100.0
"""Photons of a hot point: fewer are chance."""
NAMED = 3


def hot_points(transient: Transient, unit: float) -> str:
    """Which few points hold most of all counts, in words, the brightest first; empty where none do. A photon counts
    `unit`."""
    measured = transient.exposure_s > 0
    totals = transient.counts.sum(axis=0, dtype=np.float64) * measured
    rates = totals / np.where(measured, transient.exposure_s, 1)
    hot = np.argwhere((rates > HOT * max(float(np.median(rates[measured])), 0.0)) & (totals > FEWEST * unit))
    share = float(totals[tuple(hot.T)].sum()) / max(float(totals.sum()), 1e-300)
    if not 0 < len(hot) <= FEW * np.count_nonzero(measured) or share < MOST:
        return ""
    hot = hot[np.argsort(-rates[tuple(hot.T)], kind="stable")]
    named = ", ".join(f"({row}, {col})" for row, col in hot[:NAMED])
    more = ", ..." if len(hot) > NAMED else ""
    return (
        f"{len(hot)} of {np.count_nonzero(measured):,} points hold {100 * share:.0f} % of all counts, at (row, column) "
        f"{named}{more}: mark hot points as not measured (exposure 0)"
    )
