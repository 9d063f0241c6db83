"""How far a picture will be off that is made from so many points with so many photons each: more points, or more light?

Figures of `benchmarks/where_to_look.py --fit`: NANO's front views of 26 scenes of the kinds that it learned on, on
walls of 32 x 32 points taken coarse to fine, with two thirds as much background as light in the histogram.
"""

import numpy as np

POINTS = (26, 51, 102, 205, 410, 819, 1024)
PHOTONS = (0.146, 0.585, 2.34, 9.36, 37.4, 150.0, 599.0)
"""Indirect ones a point."""
ERROR = (
    (1.000, 1.000, 1.000, 0.919, 0.680, 0.630, 0.614),
    (1.000, 1.000, 1.000, 0.611, 0.514, 0.452, 0.440),
    (1.000, 1.000, 0.772, 0.512, 0.433, 0.377, 0.355),
    (1.000, 0.985, 0.600, 0.445, 0.352, 0.307, 0.289),
    (1.000, 0.785, 0.499, 0.411, 0.319, 0.272, 0.253),
    (0.967, 0.585, 0.459, 0.352, 0.283, 0.247, 0.228),
    (0.983, 0.568, 0.449, 0.351, 0.274, 0.242, 0.224),
)
"""Relative L2 error of the front view at its best scale: a row for each number of points, geometric means."""


def expected_error(points: float, photons: float) -> float:
    """Relative error of a front view from `points` places of the wall with `photons` of indirect light each, between
    the figures in their logarithms. More places than the operator has cells count as more light of these."""
    if points > POINTS[-1]:
        points, photons = POINTS[-1], photons * points / POINTS[-1]
    x, y = np.log(POINTS), np.log(PHOTONS)
    at = float(np.clip(np.log(max(photons, 1e-9)), y[0], y[-1]))
    column = [float(np.interp(at, y, np.log(row))) for row in ERROR]
    return float(np.exp(np.interp(np.log(max(points, 1.0)), x, column)))
