"""Whoever waits for a method is told of each part of it that is done, once, and of no more than there are."""

import numpy as np
import pytest

pytest.importorskip("torch")

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.parts import heard_by
from nlos.recon.reconstruct import reconstruct


@pytest.fixture
def transient() -> Transient:
    counts = np.random.default_rng(0).poisson(0.2, (256, 8, 8)).astype(np.float32)
    return Transient(counts, np.ones((8, 8)), WallGrid(1.0, 1.0, 8, 8), TimeAxis(256, 32e-12, 0.0))


@pytest.mark.parametrize("method", ["nano", "lfe", "lct"])
def test_each_part_is_told_once_in_every_look(transient: Transient, method: str) -> None:
    heard: list[tuple[int, int]] = []
    with heard_by(lambda done, parts, name: heard.append((done, parts))):
        reconstruct(transient, method)
    looks: list[list[int]] = []
    for done, _ in heard:
        looks += [[]] if done == 1 else []
        looks[-1].append(done)
    assert all(each == list(range(1, heard[0][1] + 1)) for each in looks)
    assert len(looks) > 1 or method == "lct"  # the picture, and what it explains of the light it did not see
    told = len(heard)
    reconstruct(transient, method)
    assert len(heard) == told


@pytest.mark.parametrize(
    ("method", "settings", "name", "rounds"),
    [
        ("gradient_descent", {"iterations": 7}, "iterations", 7),
        ("phasor", {}, "planes", None),
        ("fk", {}, "planes", None),
        ("nano", {}, "mirror images", 4),  # in pairs, of a square wall
    ],
)
def test_rounds_inside_a_part_are_told_too(
    transient: Transient, method: str, settings: dict[str, object], name: str, rounds: int | None
) -> None:
    heard: list[tuple[int, int, str]] = []
    with heard_by(lambda done, parts, part: None, within=lambda *round: heard.append(round)):
        reconstruct(transient, method, settings, explain=False)
    told = [(done, total) for done, total, what in heard if what == name]
    assert told
    assert told[-1][0] == told[-1][1] > 3
    assert rounds is None or told == [(done, rounds) for done in range(1, rounds + 1)]
