"""One instrument alone works, and says what it lacks; an unverified mirror is seen to move before it is trusted."""

import csv
import json
import math
import re
import time
from pathlib import Path

import pytest

from nlos.__main__ import run
from nlos.by_hand.opening import in_hand
from nlos.cli.terminal import terminal
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from tests.nlos.by_hand.at_a_terminal import at_a_terminal
from tests.nlos.by_hand.witness import STARVED_S, account, bench_file

MISSING = {"mirror": {"name": "G10", "parameters": {"kind": "missing"}}, "counter": {"name": "U10"}}


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


def without(folder: Path, role: str, **changes: dict[str, object]) -> str:
    fault = MISSING[role] | {"times": 99}
    return str(bench_file(folder, {**changes, "simulation": {"faults": [fault]}}))


def moved(folder: Path) -> list[tuple[float, float]]:
    """Where the beam was sent, but for the centre and the ends of its outputs' ranges: it swings there, in the dark,
    when its controller is set up."""
    ends = (0.0, -math.radians(40.0))
    return [beam for beam in account(folder).beams if not all(min(abs(a - e) for e in ends) < 1e-4 for a in beam)]


def test_the_counter_is_watched_without_the_mirror(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log.csv"
    path = without(tmp_path, "mirror")
    assert run(["monitor", "--bench", path, "--for", "1.6", "--light", "1.2", "--log", str(log), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["sync_hz"] == pytest.approx(10e6, rel=1e-3)
    rows = list(csv.DictReader(log.open()))
    assert rows
    assert any(float(row["direct_ns"] or 0) == pytest.approx(13.69, abs=0.05) for row in rows if row["light"] == "1")
    assert 0 < account(tmp_path).lit_s <= 1.2 + STARVED_S
    assert not moved(tmp_path)


def test_the_mirror_is_moved_without_the_counter_only_where_somebody_answers_for_the_light(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = without(tmp_path, "counter")
    assert run(["point", "0.2", "-0.1", "--bench", path]) == 4
    assert "nobody knows whether there is light" in capsys.readouterr().err
    assert not moved(tmp_path)
    assert run(["point", "0.2", "-0.1", "--bench", path, "--no-shutter"]) == 0
    assert "(+0.2000, -0.1000) m on the wall" in capsys.readouterr().out
    assert moved(tmp_path)


def test_a_mirror_that_drives_its_shutter_needs_no_counter(tmp_path: Path) -> None:
    path = without(tmp_path, "counter", shutter={"model": "triggerscope_ttl"}, mirror={"shutter_pin": 16})
    assert run(["point", "0.2", "-0.1", "--bench", path, "--light", "0.3"]) == 0
    assert 0 < account(tmp_path).lit_s <= 0.3 + STARVED_S


def test_there_is_no_light_where_the_beam_rests_outside_the_allowed_area(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It waits at the mirror's centre, which may be beside what is allowed: nobody has sent it anywhere yet."""
    allowed = {"left_m": 0.1, "right_m": 0.5, "bottom_m": -0.5, "top_m": 0.5}
    driven = {"shutter": {"model": "triggerscope_ttl"}, "mirror": {"shutter_pin": 16}}
    path = str(bench_file(tmp_path, {"geometry": {"allowed": allowed}, **driven}))
    assert run(["monitor", "--bench", path, "--for", "1", "--light", "0.5"]) == 4
    assert "outside the allowed area" in capsys.readouterr().err
    assert not account(tmp_path).lit
    assert run(["monitor", "--bench", path, "--at", "0.3", "0", "--for", "1", "--light", "0.5"]) == 0
    assert account(tmp_path).lit


def test_alignment_duty_is_kept(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"alignment": {"duty": 0.4, "period_s": 0.5}})
    assert run(["point", "0", "0", "--bench", str(path), "--light", "2"]) == 0
    seen = account(tmp_path)
    assert len(seen.lit) >= 2  # four on a machine that has the time
    assert all(end is not None and end - start <= 0.4 * 0.5 + STARVED_S for start, end in seen.lit)


@pytest.mark.parametrize(("words", "said"), [
    (["point", "0.3", "0.1", "--light", "500"], "outside 0.2 to 120 s"),
    (["point", "nan", "0"], "is not a place"),
    (["point", "0", "nan"], "is not a place"),
    (["point", "--deg", "41", "0"], "outside +-40.00 deg"),
    (["point", "2", "0"], "outside the allowed area"),
    (["monitor", "--at", "2", "0", "--for", "1"], "outside the allowed area"),
])  # fmt: skip
def test_what_is_refused_moves_nothing_and_lights_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    allowed = {"left_m": -1.0, "right_m": 1.0, "bottom_m": -1.0, "top_m": 1.0}
    path = bench_file(tmp_path, {"geometry": {"allowed": allowed}})
    assert run([*words, "--bench", str(path)]) == 4
    assert said in capsys.readouterr().err
    assert not account(tmp_path).lit
    assert not moved(tmp_path)


def test_first_moves_of_an_unverified_mirror_are_small_asked_for_and_seen(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"simulation": {"faults": [{"name": "A3"}]}})
    with at_a_terminal(tmp_path, "jog", "--bench", str(path)) as child:
        child.wait_for("After Enter the x mirror")
        child.press("\r")
        child.wait_for("Did the x mirror move?")
        child.press("\r")
        assert child.ends() == 3
        assert "was not seen to move" in child.said
    assert not account(tmp_path).lit


def test_nobody_at_the_terminal_moves_no_unverified_mirror(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_file(tmp_path, {"simulation": {"faults": [{"name": "A3"}]}})
    assert run(["point", "0.1", "0.1", "--bench", str(path)]) == 3
    assert "nlos jog" in capsys.readouterr().err


def test_spots_marked_in_jog_keep_their_commanded_angles(tmp_path: Path) -> None:
    with at_a_terminal(tmp_path, "jog", "--bench", str(bench_file(tmp_path)), "--marks", "spots.csv") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("g", "0.5 -0.25", "\r")
        child.wait_for("+0.5000   y   -0.2500 m")
        child.press("m")
        child.wait_for("the simulated ruler says +0.500 -0.250")
        child.press("0.5 -0.25", "\r")
        child.wait_for("spot 1 in spots.csv")
        child.press("q")
        assert child.ends() == 0
    (row,) = csv.DictReader((tmp_path / "spots.csv").open())
    assert float(row["x_deg"]) == pytest.approx(13.94, abs=0.2)
    assert (float(row["x_m"]), float(row["y_m"])) == (0.5, -0.25)


def test_enter_takes_what_the_ruler_says_and_a_beam_that_is_elsewhere_is_said_at_the_first_spot(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"simulation": {"misalignment": {"scanner_x_m": 0.25}}})
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", "spots.csv") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("m")
        child.wait_for("Enter takes that")
        child.press("0,2.5 x", "\r")
        child.wait_for("two numbers, x and y in metres, such as")
        child.press("\r")
        child.wait_for("+0.250, +0.000 m from where the bench file puts it")
        child.press("m")
        child.press("0,25 0,001", "\r")  # as some write it
        child.wait_for("spot 2 in spots.csv")
        child.press("q")
        assert child.ends() == 0
        assert f"nlos calibrate --spots spots.csv --bench {path}" in child.said
    rows = [(float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader((tmp_path / "spots.csv").open())]
    assert rows == [(0.25, 0.0), (0.25, 0.001)]


def test_three_marks_name_a_reversed_axis_and_scans_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bench_file(tmp_path, {"simulation": {"misalignment": {"x_volts_per_degree": -0.5}}})
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", "spots.csv") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        for number, (place, shown) in enumerate(
            (
                ("0 0", "+0.0000   y   +0.0000 m"),
                ("0.2 0", "+0.2000   y   +0.0000 m"),
                ("0 0.2", "+0.0000   y   +0.2000 m"),
            ),
            1,
        ):
            child.press("g", place, "\r")
            child.wait_for(shown)
            child.press("m", "\r")
            child.wait_for(f"spot {number} in spots.csv")
        child.wait_for("x is reversed: the beam goes the other way")
        child.press("q")
        assert child.ends() == 0
    assert run(["plan", "demo", "--bench", str(path)]) == 0
    said = capsys.readouterr().err
    assert "x is reversed" in said
    assert "seen by `nlos jog` on" in said


def test_the_ninth_good_mark_is_enough_and_a_mark_in_the_dark_is_warned_of(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"simulation": {"misalignment": {"scanner_x_m": 0.25}}})
    rows = [f"{x},{y},{x / 57.3 * 2 + 0.25},{y / 57.3 * 2}" for x in (-5.0, 0.0, 5.0) for y in (-5.0, 0.0, 5.0)]
    (tmp_path / "spots.csv").write_text("\n".join(["x_deg,y_deg,x_m,y_m", *rows[:7], "1,2,,"]) + "\n")
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", "spots.csv") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("m", "\r")
        child.wait_for("Nine spots and")  # eight have a ruler's value
        child.wait_for("marked with the light off")
        child.press("m", "\r")
        child.wait_for("spot 10 in spots.csv: enough: q, then nlos calibrate --spots spots.csv")
        child.press("q")
        assert child.ends() == 0
    before = child.said.count("marked with the light off")
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", "lit.csv", "--light", "20") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.wait_until(lambda: bool(account(tmp_path).lit), "light")
        child.press("m", "\r")
        child.wait_for("spot 1 in lit.csv")
        child.press("q")
        assert child.ends() == 0
        assert "marked with the light off" not in child.said
    assert before > 0


def test_a_mark_that_contradicts_an_older_one_is_said_at_once_with_both(tmp_path: Path) -> None:
    (tmp_path / "spots.csv").write_text("x_deg,y_deg,x_m,y_m\n0.0,0.0,0.3,0.1\n")
    words = ("jog", "--bench", str(bench_file(tmp_path)), "--marks", "spots.csv")
    with at_a_terminal(tmp_path, *words, environment={"COLUMNS": "80"}) as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("m", "0 0", "\r")
        child.wait_for("contradicts line 2,")
        child.wait_for("+0.000 +0.000 deg at +0.300 +0.100 m: one was misread")
        both = ("spot 2 in spots.csv: +0.000 +0.000 deg at +0.000 +0.000 m", "marked with the light off")
        child.wait_until(lambda: all(each in child.frames[-1][1] for each in both), "both on one screen of 80 columns")
        child.press("q")
        assert child.ends() == 0


def test_monitor_leaves_a_line_of_what_it_saw(tmp_path: Path) -> None:
    words = ("monitor", "--bench", str(bench_file(tmp_path)), "--light", "1", "--log", "m.csv")
    with at_a_terminal(tmp_path, *words) as child:
        child.wait_until(lambda: len(account(tmp_path).lit) == 1 and account(tmp_path).ends_dark, "light, and none")
        time.sleep(0.3)  # a few gates in the dark
        child.press("q")
        assert child.ends() == 0
        left = child.said.rpartition("q ends")[2]
    assert re.search(
        r"\d+ updates: sync 10 MHz; \d+ \+- \d+ counts/s with light; \d+ \+- \d+ counts/s without; direct peak at "
        r"13\.\d+ ns, FWHM \d+ ps, .*counts/s; light on for (\d\.\d) s in all",
        left,
    ), left
    assert "m.csv: every update" in left
    ((start_s, end_s),) = account(tmp_path).lit
    said_s = float(re.search(r"light on for (\d\.\d) s", left)[1])  # type: ignore[index]
    assert end_s is not None
    assert said_s == pytest.approx(end_s - start_s, abs=0.2 + STARVED_S)


def test_monitor_that_is_interrupted_sums_up_too(tmp_path: Path) -> None:
    with at_a_terminal(tmp_path, "monitor", "--bench", str(bench_file(tmp_path))) as child:
        child.wait_until(lambda: len(child.frames) > 3, "a screen")
        child.press("\x03")
        assert child.ends() == 130
        assert "no direct peak; light never on" in child.said.rpartition("q ends")[2]


def test_tab_gives_as_much_light_again_also_while_the_ruler_is_asked_for(tmp_path: Path) -> None:
    path = bench_file(tmp_path)
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", "s.csv", "--light", "0.5") as child:
        child.wait_until(lambda: len(account(tmp_path).lit) == 1 and account(tmp_path).ends_dark, "light, and none")
        child.press("m", "\t")
        child.wait_until(lambda: len(account(tmp_path).lit) == 2 and account(tmp_path).ends_dark, "light again")
        child.press("\x1b")
        time.sleep(0.3)
        child.press("q")
        assert child.ends() == 0
    seen = account(tmp_path)
    assert all(end is not None and end - start <= 0.5 + STARVED_S for start, end in seen.lit)


def test_without_light_that_was_stated_tab_gives_none(tmp_path: Path) -> None:
    with at_a_terminal(tmp_path, "jog", "--bench", str(bench_file(tmp_path)), "--marks", "s.csv") as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("\t", "right")
        child.wait_for("+0.1000   y   +0.0000 deg")
        child.press("q")
        assert child.ends() == 0
    assert not account(tmp_path).lit


def test_the_key_gives_light_for_no_longer_than_the_bench_allows_at_once(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"alignment": {"longest_s": 0.4}})
    with at_a_terminal(tmp_path, "jog", "--bench", str(path)) as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press(" ")
        child.wait_until(lambda: account(tmp_path).ends_dark and bool(account(tmp_path).lit), "light, and none again")
        child.press("q")
        assert child.ends() == 0
    assert account(tmp_path).lit_s <= 0.4 + STARVED_S


def test_a_key_that_was_let_go_during_the_warning_time_gives_no_light(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"arm": {"delay_s": 0.5, "remote": True}})
    with at_a_terminal(tmp_path, "jog", "--bench", str(path)) as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("   ")  # at once, as they come from a terminal that was busy
        time.sleep(0.2)
        child.press("   ")  # in the warning time
        child.wait_for("armed: SPACE gives light")
        shown = len(child.frames)
        child.wait_until(lambda: len(child.frames) > shown + 5, "five more screens")
        assert not account(tmp_path).lit

        def held_down() -> bool:  # as a keyboard repeats it: one press may be over before the next screen
            child.press(" ")
            return "light       ON" in child.said

        child.wait_until(held_down, "light       ON")
        child.press("q")
        assert child.ends() == 0
    assert account(tmp_path).lit


@pytest.mark.parametrize("held", [True, False], ids=["SPACE", "--light"])
@pytest.mark.parametrize("words", [("jog",), ("monitor",), ("point", "0", "0")], ids=lambda words: words[0])
def test_q_in_the_warning_time_ends_in_the_dark_without_waiting_for_it(
    tmp_path: Path, words: tuple[str, ...], held: bool
) -> None:
    path = bench_file(tmp_path, {"arm": {"delay_s": 60.0, "remote": True}})
    with at_a_terminal(tmp_path, *words, *(() if held else ("--light", "2")), "--bench", str(path)) as child:
        if held:
            child.wait_until(lambda: bool(child.frames) or "SPACE" in child.said, "that keys are taken")
            child.press(" ")
        child.wait_for("light in 60 s")
        if words == ("jog",):
            child.press("right")
            child.wait_for("no light: another key was pressed")
            child.wait_for("+0.1000   y   +0.0000 deg")
        child.press(" q")
        assert child.ends() == 0
    assert not account(tmp_path).lit


def test_a_key_at_the_very_end_of_the_warning_time_comes_before_light(tmp_path: Path) -> None:
    """Within the tenth of a second in which nobody looks at keys any more."""
    path = bench_file(tmp_path, {"arm": {"delay_s": 0.3, "remote": True}})
    with in_hand(load("bench", str(path), BenchSettings), {"mirror"}, 0.2) as hand:
        assert hand.bench.shutter is not None
        hand.light.broken_off = hand.bench.shutter.is_armed
        assert not hand.ask_for_light(0.2)
        assert hand.notes[-1] == "no light: another key was pressed in its warning time"
        assert not account(tmp_path).lit
        assert hand.ask_for_light(0.2)  # no warning time any more: whoever asks wants it
    assert account(tmp_path).lit


def test_q_right_behind_tab_ends_in_the_dark(tmp_path: Path) -> None:
    """Both are read at once."""
    path = bench_file(tmp_path, {"arm": {"delay_s": 60.0, "remote": True}})
    with at_a_terminal(tmp_path, "jog", "--light", "2", "--bench", str(path)) as child:
        child.wait_for("light in 60 s")
        child.press("right")
        child.wait_for("+0.1000   y   +0.0000 deg")
        announced = child.said.count("light in 60 s")
        child.press("\tq")
        assert child.ends() == 0
        assert child.said.count("light in 60 s") == announced
    assert not account(tmp_path).lit


def test_a_terminal_from_afar_may_move_but_gets_no_light(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_file(tmp_path, {"arm": {"remote": False}})
    afar = {"SSH_CONNECTION": "10.0.0.7 50000 10.0.0.1 22"}
    with at_a_terminal(tmp_path, "jog", "--bench", str(path), environment=afar) as child:
        child.wait_for("this terminal is not at the bench")
        child.press("right", " ")
        child.wait_for("+0.1000   y   +0.0000 deg")
        child.press("q")
        assert child.ends() == 0
    with at_a_terminal(tmp_path, "point", "0", ".1", "--light", "1", "--bench", str(path), environment=afar) as child:
        assert child.ends() == 4
    assert not account(tmp_path).lit
    assert all(abs(y_rad) < 1e-3 for _, y_rad in moved(tmp_path))  # refused before it moves


def test_keys_of_another_encoding_agree_to_no_light_and_are_no_fault_of_the_program(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {"arm": {"confirm": True, "remote": True}})
    words = ("point", "0", "0", "--light", "1", "--bench", str(path))
    with at_a_terminal(tmp_path, *words, environment={"PYTHONIOENCODING": "utf-8:strict"}) as child:
        child.wait_for("to agree")
        child.press("\udcfc\udce9\r")  # of a terminal that speaks Latin-1
        assert child.ends() == 4
    assert "no one agreed to light" in child.said
    assert not account(tmp_path).lit
