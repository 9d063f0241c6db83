"""What aiming by hand is made of: the peak, the chart, keys, marks, time axes."""

import math
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.direct_peak import direct_peak
from nlos.by_hand.chart import chart
from nlos.by_hand.keys import decoded
from nlos.by_hand.marks import Marks
from nlos.calibration.errors import InvalidData
from nlos.calibration_input import read_spots
from nlos.configs.load import load, names
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.axes import whole_period
from nlos.drivers.tcspc.counter import HistogramAxis

AXIS = HistogramAxis(6250, 16e-12)


def pulse(time_s: float, fwhm_s: float, photons: float, axis: HistogramAxis = AXIS) -> np.ndarray:
    """Expected counts (T,) of a Gaussian pulse round a whole period."""
    edges = (np.arange(axis.bins * 3 + 1) - axis.bins) * axis.bin_width_s
    cumulative = np.array([0.5 * (1 + math.erf((e - time_s) / (fwhm_s / 2.3548) / math.sqrt(2))) for e in edges])
    return photons * np.diff(cumulative).reshape(3, -1).sum(axis=0)


@pytest.mark.parametrize("time_ns", [0.01, 13.69, 50.0, 99.99])
@pytest.mark.parametrize("fwhm_ps", [60.0, 200.0])
def test_the_direct_peak_is_where_and_as_wide_as_it_was_made(time_ns: float, fwhm_ps: float) -> None:
    draw = np.random.default_rng(3)
    counts = draw.poisson(pulse(time_ns * 1e-9, fwhm_ps * 1e-12, 2e4) + 0.5)
    found = direct_peak(counts, AXIS, cyclic=True)
    assert found is not None
    assert found.fwhm_s is not None
    off_s = (found.time_s - time_ns * 1e-9 + 50e-9) % 100e-9 - 50e-9
    assert abs(off_s) < max(12e-12, 0.1e-12 * fwhm_ps)
    assert found.fwhm_s == pytest.approx(fwhm_ps * 1e-12, rel=0.12)
    assert found.counts == pytest.approx(2e4, rel=0.05)


def test_a_brighter_hidden_surface_is_not_taken_for_the_wall() -> None:
    counts = np.random.default_rng(1).poisson(pulse(98e-9, 70e-12, 5e3) + pulse(4e-9, 900e-12, 1.2e4) + 0.2)
    found = direct_peak(counts, AXIS, cyclic=True)
    assert found is not None
    assert found.time_s == pytest.approx(98e-9, abs=20e-12)


@pytest.mark.parametrize("seed", range(50))
def test_chance_makes_no_peak(seed: int) -> None:
    assert direct_peak(np.random.default_rng(seed).poisson(0.3, 6250), AXIS, cyclic=True) is None


def test_every_column_shows_its_highest_bin() -> None:
    counts = np.zeros(6250, np.int64)
    counts[4321] = 1000
    rows = chart(counts, 80, 6)
    assert len(rows) == 6
    assert all(len(row) == 80 for row in rows)
    assert [row.index("█") for row in rows] == [4321 * 80 // 6250] * 6


def test_what_is_faint_is_seen_on_a_logarithmic_scale_and_its_part_on_a_linear_one() -> None:
    counts = np.array([0, 10, 500, 1000])
    linear = chart(counts, 4, 2, logarithmic=False)
    assert linear == ["   █", "  ██"]  # a hundredth is nothing, a half is one of two lines
    logarithmic = chart(counts, 4, 2)
    assert [row[0] for row in logarithmic] == [" ", " "]
    assert logarithmic[1][1] in "▄▅▆"  # log 11 of log 1001, of two lines: 0.69 of one
    assert logarithmic[1][2:] == "██"


def test_keys_arrive_whole_and_what_is_none_of_ours_is_skipped() -> None:
    assert decoded(b"\x1b[A\x1b[Dq \r") == ["up", "left", "q", "space", "enter"]
    assert decoded(b"\x1b[Hq\x1bOPm") == ["q", "m"]  # Home and F1, of one letter each
    assert decoded(b"\x1b[15~\x1b[1;5Cm\xc3\xa9") == ["m"]


def test_marks_that_cannot_both_be_true_are_found_whenever_they_were_made(tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    path.write_text("x_deg,y_deg,x_m,y_m\n5.0,0.0,0.175,0.0\nnot yet,,,\n-5.0,0.0,,\n")
    marks, turned = Marks(path), math.radians(5.0)
    same_angles = marks.add(MirrorAngles(turned, 0.0), (0.21, 0.0))
    assert [each.line for each in marks.contradicted_by(same_angles, 2.0)] == [2]
    assert "+5.000 +0.000 deg at +0.210 +0.000 m" in str(same_angles)
    assert marks.contradicted_by(marks.add(MirrorAngles(turned, 0.0), None), 2.0) == []  # to be filled in later
    same_place = marks.add(MirrorAngles(0.0, turned), (0.176, 0.001))
    assert [each.line for each in marks.contradicted_by(same_place, 2.0)] == [2]
    by_hand = marks.add(MirrorAngles(turned + 1e-4, 0.0), (0.2, 0.003))  # a ruler's few millimetres, either way
    assert [each.line for each in marks.contradicted_by(by_hand, 2.0)] == [2]
    elsewhere = marks.add(MirrorAngles(-turned, 0.0), (-0.175, 0.0))  # its partner has no ruler's value yet
    assert marks.contradicted_by(elsewhere, 2.0) == []


def test_marks_are_spots_that_calibrate_reads(tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    Marks(path).add(MirrorAngles(0.1, -0.05), (0.2, -0.1))
    again = Marks(path)
    again.add(MirrorAngles(-0.1, 0.05), (-0.2, 0.1))
    assert again.count == 2
    spots = read_spots(path)
    assert spots.x_rad == pytest.approx([0.1, -0.1], abs=1e-7)
    assert spots.y_m == pytest.approx([-0.1, 0.1])


def test_spots_without_a_rulers_value_are_counted_and_named_by_calibrate(tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    marks = Marks(path)
    marks.add(MirrorAngles(0.0, 0.0), (0.2, -0.1))
    marks.add(MirrorAngles(0.1, 0.0), None)
    assert (marks.count, marks.unmeasured) == (2, 1)
    assert (Marks(path).count, Marks(path).unmeasured) == (2, 1)
    with pytest.raises(InvalidData, match=r"spots\.csv:3: x_m and y_m empty: write in what the ruler says"):
        read_spots(path)
    path.write_text("x_deg,y_deg,x_m,y_m\n1,2,0;3,4\n")
    with pytest.raises(InvalidData, match=r"spots\.csv:2: not four numbers .*x_m '0;3'"):
        read_spots(path)


def test_marks_are_added_by_the_header_of_the_table(tmp_path: Path) -> None:
    """In the order that its author chose, other columns left empty, and no row of theirs run on into ours."""
    path = tmp_path / "spots.csv"
    path.write_text("x_m, y_m, who, y_deg, x_deg\n0.3,0.1,Ada,2.5,7.5\n,,Ada,1.0,2.0", encoding="utf-8-sig")
    marks = Marks(path)
    assert (marks.count, marks.unmeasured) == (2, 1)
    assert marks.add(MirrorAngles(0.1, -0.05), (0.2, -0.1)).line == 4
    Marks(path).add(MirrorAngles(-0.1, 0.05), (-0.2, 0.1))
    assert [each.line for each in marks.contradicted_by(marks.add(MirrorAngles(0.1, -0.05), (0.3, 0.0)), 2.0)] == [4]
    rows = path.read_text("utf-8-sig").splitlines()
    assert rows[2:5] == [
        ",,Ada,1.0,2.0",
        "0.20000,-0.10000,,-2.864789,5.729578",
        "-0.20000,0.10000,,2.864789,-5.729578",
    ]
    path.write_text("\n".join([*rows[:2], *rows[3:]]), encoding="utf-8-sig")
    spots = read_spots(path)
    assert spots.x_rad[1:] == pytest.approx([0.1, -0.1, 0.1], abs=1e-7)
    assert spots.x_m == pytest.approx([0.3, 0.2, -0.2, 0.3])


def test_a_table_may_be_corrected_or_put_away_between_two_marks(tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    marks = Marks(path)
    for place in ((0.0, 0.0), (0.3, 0.1)):
        marks.add(MirrorAngles(0.0, 0.0), place)
    path.write_text("\n".join([*path.read_text().splitlines()[:1], "", "7,1,0.2,0.0"]))  # ends in no line's end
    new = marks.add(MirrorAngles(0.0, 0.0), (0.2, 0.1))
    assert (new.line, marks.count, marks.contradicted_by(new, 2.0)) == (4, 2, [])
    assert read_spots(path).x_m == pytest.approx([0.2, 0.2])
    path.rename(tmp_path / "older.csv")
    assert marks.add(MirrorAngles(0.1, 0.0), (0.2, 0.1)).line == 2
    assert (marks.count, marks.added) == (1, 4)
    assert read_spots(path).x_m == pytest.approx([0.2])
    path.write_text("no table\n")
    with pytest.raises(InvalidData, match="its header has no column"):
        marks.add(MirrorAngles(0.1, 0.0), (0.2, 0.1))
    assert path.read_text() == "no table\n"


@pytest.mark.parametrize("text", ["", "\n"])
def test_an_empty_table_gets_its_header_with_the_first_mark(text: str, tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    path.write_text(text)
    marks = Marks(path)
    assert marks.count == 0
    new = marks.add(MirrorAngles(0.1, -0.05), (0.2, -0.1))
    assert read_spots(path).x_m == pytest.approx([0.2])
    assert path.read_text().splitlines()[new.line - 1].startswith("5.729578,")


@pytest.mark.parametrize("header", ["x,y", "x_deg;y_deg;x_m;y_m", "x_deg,y_deg,x_m", "x_deg,y_deg,x_m,y_m,x_m"])
def test_a_table_that_is_none_of_spots_is_not_written_on(header: str, tmp_path: Path) -> None:
    path = tmp_path / "spots.csv"
    path.write_text(f"{header}\n1,2\n")
    with pytest.raises(InvalidData, match=r"spots\.csv: its header has no column, or two, of .*Name another file"):
        Marks(path)


@pytest.mark.parametrize("bench", [name for name in names("bench") if name != "lab"])
def test_every_counter_has_bins_for_the_whole_period(bench: str) -> None:
    settings = load("bench", bench, BenchSettings).settings
    with open_bench(settings) as opened:
        axis = whole_period(opened.counter, settings.laser.repetition_hz, 0.06)
        opened.counter.configure(axis)
    assert axis.bins * axis.bin_width_s >= 1 / settings.laser.repetition_hz
    assert axis.bin_width_s <= 40e-12
