"""Photons of a simulated bench: equal gates are independent draws, a plan's points the same ones whatever happens."""

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import open_bench
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates
from tests.acquisition.fault_cases import BENCHES, plan, settings

GATES, DWELL_S = 40, 0.05


def _film(name: str) -> ScanPlan:
    return plan(name, rows=3, cols=4, dwell_ms=4.0, frames=3)


def _counts(name: str, scheme: Scheme | None, taken: dict[int, int]) -> dict[int, npt.NDArray[np.uint32]]:
    with open_bench(settings(name)) as bench:
        return {
            each.point.number: each.histogram.counts for each in scan(_film(name), bench, taken=taken, scheme=scheme)
        }


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize("scheme", [None, Scheme.STEPPED])
def test_frames_are_draws_of_their_own_and_resumed_ones_the_same(name: str, scheme: Scheme | None) -> None:
    """Squares of what two frames differ by, over what they hold together: 1 of two Poisson draws, 0 of a copy."""
    film, whole = _film(name), _counts(name, scheme, {})
    frames = np.zeros((3, len(film) // 3, film.axis.bins), np.int64)
    place = {where: k for k, where in enumerate(sorted(set(zip(film.positions.x_m, film.positions.y_m, strict=True))))}
    for number, counts in whole.items():
        where = place[film.positions.x_m[number], film.positions.y_m[number]]
        frames[film.pass_[number], where] = counts
    for one, other in ((0, 1), (1, 2), (0, 2)):
        apart = ((frames[one] - frames[other]) ** 2).sum() / (frames[one] + frames[other]).sum()
        assert 0.8 < apart < 1.2
    rest = _counts(name, scheme, dict.fromkeys(range(17), 0))
    assert set(rest) == set(range(17, len(film)))
    assert all(np.array_equal(counts, whole[number]) for number, counts in rest.items())


@pytest.mark.parametrize("name", BENCHES)
def test_equal_gates_by_hand_are_independent_draws(name: str) -> None:
    """Nobody announced them, the beam rests, all are of one length: totals scatter as Poisson's do."""
    taken = []
    for _ in range(2):
        with open_bench(settings(name)) as bench:
            bench.counter.configure(bench.counter.nearest_axis(HistogramAxis(512, 32e-12)))
            bench.shutter.release()
            bench.shutter.open()
            rows = []
            for first in range(0, GATES, GATES // 2):
                bench.counter.arm(PointGates([DWELL_S] * (GATES // 2), range(first, first + GATES // 2)))
                for index in range(GATES // 2):
                    bench.counter.trigger()
                    bench.counter.wait_points(index + 1, timeout_s=2.0)
                    rows += bench.counter.read(index, 1)
            bench.shutter.close()
        taken.append(np.array([each.counts for each in rows], np.int64))
    counts, again = taken
    assert np.array_equal(counts, again)
    assert counts.sum() > 500
    totals = counts.sum(axis=1)
    assert 0.5 < totals.var(ddof=1) / totals.mean() < 1.7  # 40 gates: 1 +- 0.23
    assert len(np.unique(counts, axis=0)) == GATES
