"""What `point` and `monitor` are told, and what stands against light: refused in a sentence, before anything moves."""

import csv
import os
import signal
import sys
from pathlib import Path

import pytest
import yaml

from nlos.by_hand import opening, stops
from nlos.by_hand.watching import DWELL_S
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.partial_bench import open_partial_bench
from tests.command import nlos
from tests.nlos.by_hand.witness import account, bench_file


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        ("monitor --gate 10", 2, "--gate 10: two times in ns with a colon between them, such as 10:30"),
        ("monitor --gate 1:2:3", 2, "two times in ns with a colon"),
        ("monitor --gate a:b", 2, "two times in ns with a colon"),
        ("monitor --gate 30:10", 2, "must begin at 0 or later, and end after its beginning"),
        ("monitor --gate -1:10", 2, "must begin at 0 or later"),
        ("monitor --gate 5:inf", 2, "must begin at 0 or later"),
        ("monitor --gate nan:10", 2, "must begin at 0 or later"),
        ("monitor --for 0", 2, "--for 0: seconds are expected, above 0"),
        ("monitor --for nan", 2, "--for nan: seconds are expected"),
        ("monitor --for 1 --log kept.csv", 6, "kept.csv: exists. Choose another name with --log, or use --overwrite."),
        ("monitor --for 1 --log linked.csv", 6, "linked.csv: exists."),
        ("monitor --for 1 --log run.h5 --overwrite", 2, "run.h5: a log is written as .csv (given .h5)."),
        (
            "monitor --for 1 --log no/such/log.csv",
            2,
            "no is not a folder. Make it first, or choose another place with --log.",
        ),
        ("point --deg nan 0", 4, "(nan, 0) deg are not angles."),
        ("point --deg 0 inf", 4, "(0, inf) deg are not angles."),
    ],
)
def test_words_that_mean_nothing_or_would_lose_a_file_are_refused(
    tmp_path: Path, words: str, code: int, sentence: str
) -> None:
    bench_file(tmp_path)
    (tmp_path / "kept.csv").write_text("of yesterday\n")
    (tmp_path / "run.h5").write_text("a recording\n")
    (tmp_path / "linked.csv").symlink_to("nothing.csv")
    done = nlos(tmp_path, *words.split(), "--bench", "bench.yaml")
    assert (done.returncode, sentence in done.stderr) == (code, True), done.stderr
    assert (tmp_path / "kept.csv").read_text() == "of yesterday\n"
    assert (tmp_path / "run.h5").read_text() == "a recording\n"
    assert not (tmp_path / "nothing.csv").exists()
    assert not account(tmp_path).lit


def test_a_log_is_replaced_where_somebody_said_so(tmp_path: Path) -> None:
    bench_file(tmp_path)
    (tmp_path / "m.csv").write_text("of yesterday\n")
    done = nlos(tmp_path, "monitor", "--for", "0.3", "--log", "m.csv", "--overwrite", "--bench", "bench.yaml")
    assert done.returncode == 0, done.stderr
    assert "m.csv: every update" in done.stdout
    assert (tmp_path / "m.csv").read_text().startswith("utc,light,sync_hz")
    done = nlos(tmp_path, "monitor", "--for", "0.3", "--log", "new/m.csv", "--bench", "bench.yaml")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "new" / "m.csv").read_text().startswith("utc,light,sync_hz")


def test_a_dry_run_by_hand_refuses_light_and_moves_all_the_same(tmp_path: Path) -> None:
    bench_file(tmp_path, {"safety": {"dry_run": True}})
    for words in ("point 0.1 0 --light 0.5", "monitor --for 1 --light 0.5"):
        done = nlos(tmp_path, *words.split(), "--bench", "bench.yaml")
        assert (done.returncode, "safety.dry_run is set" in done.stderr) == (4, True), done.stderr
    assert nlos(tmp_path, "point", "0.1", "0", "--hold", "0", "--bench", "bench.yaml").returncode == 0
    assert not account(tmp_path).lit


@pytest.mark.parametrize(
    ("there", "agreed", "why"),
    [
        (False, True, "no one is at a terminal to confirm that the laser is at 2 mW (alignment.power_mw)."),
        (True, False, "the laser was not turned down to 2 mW."),
        (True, True, ""),
    ],
)
def test_there_is_light_by_hand_once_somebody_has_turned_the_laser_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool, agreed: bool, why: str
) -> None:
    """Of a real bench; a simulated laser has no power to turn down."""
    settings = load("bench", str(bench_file(tmp_path, {"alignment": {"power_mw": 2.0}})), BenchSettings).settings
    asked: list[str] = []

    def agrees(what: str, word: str) -> bool:
        asked.append(f"{what} {word}")
        return agreed

    monkeypatch.setattr(opening, "somebody_is_there", lambda: there)
    monkeypatch.setattr(opening, "agrees", agrees)
    with open_partial_bench(settings, {"counter"}) as bench:
        assert opening.why_no_light(bench) == ""
        assert not asked
        monkeypatch.setattr(BenchSettings, "simulated", property(lambda _: False))
        assert opening.why_no_light(bench) == why
    assert asked == ["Turn the laser down to 2 mW, the bench file's alignment power. done"] * there


SHORT = {"duty": 0.2, "period_s": 0.5}
"""Light of some 40 ms, as long as a gate: hardly one lies in it as a whole."""


@pytest.mark.parametrize(("counter", "alignment"), [("simulated", {}), ("multiharp", {}), ("multiharp", SHORT)])
def test_too_many_photons_by_hand_shut_the_light_until_somebody_clears_the_trip(
    tmp_path: Path, counter: str, alignment: dict[str, object]
) -> None:
    """Whoever notices: the instrument itself, or this program where the counter has no trip of its own."""
    bench_file(tmp_path, {"safety": {"trip_cps": 2000.0}, "alignment": alignment}, name=counter)
    words = ("monitor", "--bench", "bench.yaml", "--light", "3", "--for", "4")
    done = nlos(tmp_path, *words)
    assert (done.returncode, "shutter: closed by a trip" in done.stderr) == (4, True), done.stderr
    seen = account(tmp_path)
    assert seen.ends_dark
    assert seen.lit
    again = nlos(tmp_path, *words)
    assert again.returncode == 4
    assert "shutter: stays closed: after a trip (" in again.stderr
    assert len(account(tmp_path).lit) == len(seen.lit)
    command = "doctor --bench BENCH --clear-trip YOUR-NAME"  # without --bench it would be the simulated one's trip
    assert f"run `nlos {command}`" in again.stderr
    cleared = nlos(tmp_path, *command.replace("BENCH", "bench.yaml").replace("YOUR-NAME", "Ada").split())
    name = yaml.safe_load((tmp_path / "bench.yaml").read_text("utf-8"))["name"]
    assert f"trip of {name} cleared in the name of Ada" in cleared.stdout


def test_a_gate_in_which_light_came_and_went_is_none_of_the_dark(tmp_path: Path) -> None:
    with opening.in_hand(load("bench", str(bench_file(tmp_path)), BenchSettings), {"counter"}, 5.0) as hand:
        assert hand.watch is not None
        assert hand.bench.counter is not None
        assert hand.watch.look().lit is False

        def came_and_went() -> None:
            if not account(tmp_path).lit:
                hand.ask_for_light(5.0)
                hand.light.end("it was enough")

        hand.bench.counter.meanwhile(came_and_went)
        assert hand.watch.look().lit is None
        assert hand.watch.look().lit is False
    assert len(account(tmp_path).lit) == 1


def test_what_is_summed_is_of_one_kind_of_light(tmp_path: Path) -> None:
    """Also where the light changes between two gates: the rate in the dark is none of the light's."""
    with opening.in_hand(load("bench", str(bench_file(tmp_path)), BenchSettings), {"counter"}, 5.0) as hand:
        assert hand.watch is not None
        hand.ask_for_light(5.0)
        assert [hand.watch.look().lit for _ in range(3)] == [True] * 3
        hand.light.end("it was enough")
        assert hand.watch.look().lit is False
        assert hand.watch.summed_s == pytest.approx(DWELL_S, rel=0.1)


def test_the_direct_peak_is_where_it_was_while_somebody_zooms_on_it_and_back(tmp_path: Path) -> None:
    with opening.in_hand(load("bench", str(bench_file(tmp_path)), BenchSettings), {"counter"}, 20.0) as hand:
        assert hand.watch is not None
        hand.ask_for_light(20.0)
        found_s, bins = [], []
        for part in ((None, None), (11.7e-9, 15.7e-9), (None, None)):
            hand.look_at(*part)
            for _ in range(3):
                hand.update()
            assert hand.peak is not None
            found_s.append(hand.peak.time_s)
            bins.append(len(hand.watch.summed))
        assert found_s == pytest.approx([13.69e-9] * 3, abs=0.05e-9)
        assert bins[0] == bins[2] > bins[1]


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-Z is no signal there")
def test_ctrl_z_while_light_may_be_on_stops_only_once_it_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    lit, stopped = True, []
    monkeypatch.setattr(stops, "light_may_be_on", lambda: lit)
    monkeypatch.setattr(stops, "STOP", None)
    hand = stops.Stops()
    with hand.caught(), hand.around(lambda: stopped.append("stop"), lambda: stopped.append("on")):
        with hand.at_once():
            os.kill(os.getpid(), signal.SIGTSTP)
            assert (hand.wanted, stopped) == (True, [])
            hand.wanted = lit = False
            os.kill(os.getpid(), signal.SIGTSTP)
            assert (hand.wanted, stopped) == (False, ["stop", "on"])
        os.kill(os.getpid(), signal.SIGTSTP)  # an instrument may be spoken to now
        assert (hand.wanted, stopped) == (True, ["stop", "on"])


def test_light_at_full_duty_is_not_interrupted_and_a_window_shows_that_part_alone(tmp_path: Path) -> None:
    bench_file(tmp_path, {"alignment": {"period_s": 0.5}})
    words = "monitor --gate 40:60 --light 0.9 --for 1.2 --log m.csv --bench bench.yaml"
    done = nlos(tmp_path, *words.split())
    assert done.returncode == 0, done.stderr
    lit = [row for row in csv.DictReader((tmp_path / "m.csv").open()) if row["light"] == "1"]
    assert lit
    assert not any(row["direct_ns"] for row in lit)  # it lies at 13.7 ns
    assert len(account(tmp_path).lit) == 1


@pytest.mark.parametrize("words", ["point 0.1 0", "monitor --at 0.1 0 --for 1"])
def test_a_beam_without_its_mirror_is_sent_nowhere_and_the_mirror_named(tmp_path: Path, words: str) -> None:
    missing = {"name": "G10", "times": 99, "parameters": {"kind": "missing"}}
    bench_file(tmp_path, {"simulation": {"faults": [missing]}})
    done = nlos(tmp_path, *words.split(), "--bench", "bench.yaml")
    assert (done.returncode, "nlos: triggerscope" in done.stderr) == (3, True), done.stderr
    assert not account(tmp_path).lit
