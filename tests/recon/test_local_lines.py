"""Places by lines are surer where something goes straight, and where it turns no farther off than places alone."""

import numpy as np
import pytest

from nlos.recon.local_lines import on_line, scatter

OFF_M = 0.014
TIME_S = np.arange(40) * 0.1
PATHS = {
    "rests": np.zeros((40, 3)),
    "goes": np.outer(TIME_S, [0.5, 0.2, 0.1]),
    "goes there and back": np.abs(TIME_S - 2)[:, None] * [0.5, 0, 0],
    "goes round": np.stack([0.3 * np.cos(2 * TIME_S), 0.3 * np.sin(2 * TIME_S), 0 * TIME_S], axis=1),
}


def off_by(path: np.ndarray, as_it_comes: bool, most: int = 9) -> tuple[float, float, float]:
    """Median distances of places alone and by lines, and how often coordinates lie within 1.645 errors."""
    alone, lines, within = [], [], []
    for seed in range(12):
        places = path + np.random.default_rng(seed).normal(size=path.shape) * OFF_M
        for at in range(8, 40):
            known = slice(0, at + 1) if as_it_comes else slice(None)
            off_m = scatter(places[known], TIME_S[known])
            place, error = on_line(places[known], TIME_S[known], at, off_m, most)
            alone.append(np.linalg.norm(places[at] - path[at]))
            lines.append(np.linalg.norm(place - path[at]))
            within.append(np.abs(place - path[at]) < 1.645 * error)
    return float(np.median(alone)), float(np.median(lines)), float(np.mean(within))


def test_scatter_is_that_of_the_places_whatever_the_path_is() -> None:
    for path in PATHS.values():
        places = path + np.random.default_rng(1).normal(size=path.shape) * [OFF_M, 2 * OFF_M, 0.5 * OFF_M]
        assert scatter(places, TIME_S) == pytest.approx([OFF_M, 2 * OFF_M, 0.5 * OFF_M], rel=0.35)
    assert np.isnan(scatter(np.zeros((2, 3)), TIME_S[:2])).all()


@pytest.mark.parametrize("as_it_comes", [False, True])
@pytest.mark.parametrize(
    ("path", "gain", "held"), [("rests", 0.7, 0.75), ("goes", 0.7, 0.75), ("goes there and back", 0.8, 0.7),
                               ("goes round", 1.1, 0.6)],
)  # fmt: skip
def test_lines_are_surer_and_do_not_cut_turns_short(path: str, gain: float, held: float, as_it_comes: bool) -> None:
    alone, lines, within = off_by(PATHS[path], as_it_comes)
    assert lines < gain * alone
    assert within > held


def test_no_line_reaches_over_a_gap() -> None:
    time_s = np.concatenate([TIME_S[:5], TIME_S[5:10] + 20])
    places = (
        np.concatenate([np.zeros((5, 3)), np.full((5, 3), 1.0)]) + np.random.default_rng(0).normal(size=(10, 3)) * 1e-4
    )
    off_m = scatter(places, time_s)
    assert (off_m < 1e-3).all()
    place, _ = on_line(places, time_s, 4, np.full(3, 5.0), 9)  # whatever is off, the others are 20 s later
    assert np.abs(place).max() < 1e-3


def test_places_that_share_what_is_off_are_no_surer_for_being_many() -> None:
    drawn = np.random.default_rng(2).normal(size=(43, 3)) * OFF_M
    places = np.stack([drawn[k : k + 4].mean(axis=0) * 2 for k in range(40)])  # of OFF_M each
    off_m = scatter(places, TIME_S, 4)
    assert off_m == pytest.approx([OFF_M] * 3, rel=0.5)
    assert (scatter(places, TIME_S) < 0.75 * off_m).all()
    _, shared = on_line(places, TIME_S, 20, off_m, 9, 4)
    _, alone = on_line(places, TIME_S, 20, off_m, 9)
    assert (shared > 1.9 * alone).all() or (shared == off_m).all()


def test_a_place_alone_is_itself() -> None:
    place, error = on_line(np.ones((1, 3)), TIME_S[:1], 0, np.full(3, np.nan), 9)
    assert (place == 1).all()
    assert np.isnan(error).all()
