"""Whether another wall explains a scan's light better: the rule, NANO on wrong walls, and where it is told."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.explained_share import Explained
from nlos.recon.live import LiveReconstruction
from nlos.recon.other_geometry import WIDER, Judged, better_wall
from nlos.recon.pictures import MISPLACED, summary_figure
from nlos.recon.reconstruct import explained, reconstruct
from nlos.recon.results import read_explained, read_reconstruction, write_results
from nlos.recon.sharpness import sharpness
from nlos.recon.training.dataset import DatasetSettings, sample
from nlos.recon.training.detector import DetectorSettings

PLAIN = {"noiseless": 0.0, "uniform": 0.0, "sparse": 0.0, "uneven_dwell": 0.0, "jitter_fwhm_most_ps": 0.0,
         "afterpulsing_most": 0.0, "pile_up": 0.0, "calibration_residue": 0.0}  # fmt: skip


def drawn(index: int) -> Transient:
    detector = DetectorSettings(**PLAIN, peak_counts_least=20, peak_counts_most=20.1)  # type: ignore[arg-type]
    data = DatasetSettings(seed=41, degradations=1, rows=32, cols=32, held_out=True, detector=detector)
    made = sample(data, index)
    return Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)


def with_wall(scan: Transient, scale: float) -> Transient:
    wall = scan.wall
    return replace(scan, wall=WallGrid(scale * wall.width_m, scale * wall.height_m, wall.rows, wall.cols))


def points() -> Transient:
    """Twenty points of light in space."""
    wall, time, rng = WallGrid(1.0, 1.0, 32, 32), TimeAxis(256, 48e-12), np.random.default_rng(3)
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    expected, (row, col) = np.full((256, 32, 32), 0.01), np.indices((32, 32))
    for _ in range(20):
        at_x, at_y, z = rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(0.5, 0.9)
        r = np.sqrt((x - at_x) ** 2 + (y - at_y) ** 2 + z**2)
        np.add.at(expected, ((2 * r / 299792458 / 48e-12).astype(int), row, col), 2 / r**4)
    return Transient(rng.poisson(expected).astype(np.float32), np.ones((32, 32)), wall, time)


def judged(share: float, spread: float = 0.01) -> Judged:
    there = np.ones(256)
    missed = (1 - share) * there + spread * np.where(np.arange(256) % 2, 1, -1)
    return Judged(share, spread / 16, "", missed, there)


@pytest.mark.parametrize(
    ("wall", "own", "wider", "narrower", "said"),
    [
        (0.8, 0.60, 0.75, 0.40, "1.25 times as large explains 75 % of the light instead of 60 %"),
        (1.25, 0.60, 0.40, 0.75, "0.8 times as large"),
        (0.8, 0.60, 0.58, 0.55, ""),
        (0.8, 0.60, 0.62, 0.40, ""),  # too little
        (0.8, 0.60, 0.80, 0.70, ""),  # either way: the picture is bad, not its wall
        (0.8, 0.95, 0.99, 0.40, ""),  # nothing left to gain
        (1.25, 0.60, None, 0.80, "0.8 times as large"),
        (0.8, 0.60, 0.80, None, "1.25 times as large"),
        (0.8, 0.60, None, None, ""),
        (1.0, 0.60, 0.75, 0.40, "1.25 times as large"),  # so much gain is believed where little is explained
        (1.0, 0.60, 0.66, 0.40, ""),  # not so little, against the light cones
        (1.0, 0.80, 0.92, 0.40, ""),  # nor where much is explained
        (1.0, 0.60, 0.40, 0.75, ""),
    ],
)
def test_another_wall_has_to_explain_clearly_more(
    wall: float, own: float, wider: float | None, narrower: float | None, said: str
) -> None:
    other = {WIDER: wider, 1 / WIDER: narrower}

    def judge(scale: float) -> Judged | None:
        share = other[scale]
        return None if share is None else judged(share, 0.0)

    found = better_wall(with_wall(points(), wall), judged(own), judge)
    assert found.startswith("a wall " + said) if said else found == ""


def test_a_gain_within_its_error_is_none() -> None:
    def judge(scale: float) -> Judged:
        return judged(0.75 if scale > 1 else 0.4, 3.0)

    assert better_wall(with_wall(points(), 0.8), judged(0.6, 0.0), judge) == "", "0.15 +- 0.19"


def test_other_walls_are_looked_at_only_where_the_light_cones_or_a_poor_picture_speak_for_them() -> None:
    scan = points()

    def looked_at(wall: float, own: float) -> list[float]:
        asked = []

        def judge(scale: float) -> Judged:
            asked.append(scale)
            return judged(own)

        better_wall(with_wall(scan, wall), judged(own), judge)
        return asked

    assert looked_at(1.0, 0.8) == []
    assert looked_at(1.0, 0.6) == [WIDER]
    assert looked_at(0.8, 0.8) == [WIDER]
    assert looked_at(1.25, 0.8) == [1 / WIDER]
    assert looked_at(0.8, 0.95) == []


def test_light_is_sharpest_on_a_wall_of_its_own_size() -> None:
    scan = points()
    of = {scale: sharpness(scan, scale) for scale in (0.64, 0.8, 1.0, 1.25, 1.56)}
    assert max(of, key=of.__getitem__) == 1.0
    assert of[1.0] > 1.3 * max(of[0.8], of[1.25])


def test_nano_doubts_a_wall_of_the_wrong_size_and_not_the_right_one() -> None:
    scan = drawn(3)
    right = explained(scan, "nano", elsewhere=True)
    assert right.doubt == ""
    for scale, word in ((0.64, "1.25 times"), (1.56, "0.8 times")):
        wrong = explained(with_wall(scan, scale), "nano", elsewhere=True)
        assert f"a wall {word} as large" in wrong.doubt
        assert not wrong.nothing
    assert explained(with_wall(scan, 0.64), "nano").doubt == "", "it was not asked for"
    assert explained(with_wall(scan, 0.64), "lct", elsewhere=True).doubt == "", "not a method that can tell"
    live = LiveReconstruction("nano")
    told = live.explained(live.update(with_wall(scan, 0.64), 1024), with_wall(scan, 0.64)).reconstruction.explained
    assert told is not None
    assert "a wall 1.25 times as large" in told.doubt


def test_points_out_of_order_are_told_by_every_method_and_kept(tmp_path: Path) -> None:
    scan = drawn(1)
    counts = scan.counts.copy()
    counts[:, 1::2] = counts[:, 1::2, ::-1]
    made = reconstruct(replace(scan, counts=counts), "lct")
    assert made.explained is not None
    assert "every second line" in made.explained.doubt
    assert "doubtful: every second line" in str(made.explained)
    assert "doubtful" not in made.explained.figure
    assert summary_figure(made).get_suptitle() == MISPLACED
    write_results(tmp_path / "made", made)
    assert read_explained(tmp_path / "made").doubt == made.explained.doubt
    kept = read_reconstruction(tmp_path / "made" / "reconstruction.h5").explained
    assert kept is not None
    assert kept.doubt == made.explained.doubt
    with h5py.File(tmp_path / "made" / "reconstruction.h5", "a") as file:
        del file.attrs["explained_doubt"]
    assert read_explained(tmp_path / "made").doubt == "", "of a file from before"


def test_the_report_warns_of_a_doubtful_geometry() -> None:
    from nlos.report.page import _label

    made = replace(reconstruct(points(), "lct", explain=False), explained=Explained(0.6, 0.01))
    assert _label(made) == ""
    told = _label(replace(made, explained=Explained(0.6, 0.01, doubt="a wall <b>")))
    assert "in doubt" in told
    assert "<b>" not in told
