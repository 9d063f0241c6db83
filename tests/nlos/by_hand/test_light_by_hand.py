"""Light by hand, by the simulated table's own account: only while it is asked for, for no longer than was said, nowhere
beyond the limits, whatever ends the command."""

import json
import math
import os
import random
import signal
import time
from pathlib import Path

import pytest

from nlos.by_hand.hand import FIRST_HOLD_S
from tests.nlos.by_hand.at_a_terminal import AtATerminal, at_a_terminal
from tests.nlos.by_hand.witness import STARVED_S, account, bench_file

SOAK = os.environ.get("NLOS_SOAK") == "1"
ALLOWED = {"left_m": -0.3, "right_m": 0.35, "bottom_m": -0.2, "top_m": 0.25}
ENDS = ("key", "Ctrl-C", "TERM", "kill", "cable", "time")
CABLES = {"jog": ("G8", "U11"), "monitor": ("U11",), "point": ("G8", "U11")}
WATCHDOG_S = 2.0
MARGIN_RAD = 1e-4


def used(child: AtATerminal, verb: str, draw: random.Random, seconds: float) -> float:
    """Somebody presses keys for so long. Returns for how long a held key may have given light."""
    until_s, held_s = time.monotonic() + seconds, 0.0
    last_s = -math.inf
    while time.monotonic() < until_s and child.process.poll() is None:
        key = draw.choice((" ", " ", "up", "left", "right", "down", "+", "-", "0", "z", "l"))
        if verb == "point" and key != " ":
            key = " "  # any other key ends it
        if verb == "monitor" and key in ("+", "-"):
            continue
        if verb == "jog" and draw.random() < 0.1:
            child.press("g", f"{draw.uniform(-2, 2):.2f} {draw.uniform(-2, 2):.2f}", "\r")
        try:
            child.press(key)
        except OSError:
            break
        if key == " ":
            now_s = time.monotonic()
            held_s += min(FIRST_HOLD_S, now_s - last_s)
            last_s = now_s
        time.sleep(draw.choice((0.02, 0.05, 0.2)))
    return held_s + (FIRST_HOLD_S if last_s > -math.inf else 0.0)


def ended(child: AtATerminal, how: str) -> int | None:
    """Exit code, after somebody ended it in this way; None where it had ended by itself."""
    if child.process.poll() is not None:
        return None
    if how == "key":
        child.press("q")
    elif how == "Ctrl-C":
        child.press("\x03")
    elif how == "TERM":
        child.signal(signal.SIGTERM)
    elif how == "kill":
        child.signal(signal.SIGKILL)
    elif how == "cable":
        until_s = time.monotonic() + 5.0
        while child.process.poll() is None and time.monotonic() < until_s:
            time.sleep(0.05)
        if child.process.poll() is None:  # the cable of an instrument that this command does not use
            child.press("q")
    return child.ends()


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(200) if SOAK else (3, 10, 14))
def test_light_only_while_asked_for_and_never_beyond_the_limits(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    how, verb = ENDS[seed % len(ENDS)], ("jog", "monitor", "point")[seed // len(ENDS) % 3]
    said_s = draw.choice((None, 0.5, 1.0, 3.0)) if how != "time" else draw.choice((0.3, 0.7, 1.2))
    on_the_mirror = draw.random() < 0.3
    changes: dict[str, dict[str, object]] = {
        "geometry": {"allowed": ALLOWED},
        "simulation": {"faults": [{"name": draw.choice(CABLES[verb]), "after_s": 1.5}] if how == "cable" else []},
    }
    if on_the_mirror:
        changes["shutter"] = {"model": "triggerscope_ttl"}
        changes["mirror"] = {"shutter_pin": 16}
    path = bench_file(tmp_path, changes)
    words = [verb, *(("0.1", "-0.05") if verb == "point" else ()), "--bench", str(path)]
    if said_s is not None:
        words += ["--light", str(said_s)]
    if verb == "monitor" and how == "time":
        words += ["--for", "2"]
    with at_a_terminal(tmp_path, *words) as child:
        child.wait_until(lambda: bool(child.frames) or "light" in child.said, "a first screen")
        held_s = used(child, verb, draw, draw.uniform(0.3, 1.5 if how != "cable" else 4.0))
        if how == "time" and verb == "jog":
            time.sleep(said_s or 0.0)
            child.press("q")
        elif how == "time" and verb == "point":
            assert child.ends() == 0
        code = ended(child, how)
    seen = account(tmp_path)
    figures = {
        "verb": verb, "end": how, "asked_s": (said_s or 0.0) + held_s, "lit_s": seen.lit_s, "openings": len(seen.lit),
        "ends_dark": seen.ends_dark,
    }  # fmt: skip
    print(json.dumps(figures))
    if code is not None and verb != "point":  # which may be ending by itself at just that moment
        assert code == {"kill": -9, "Ctrl-C": 130, "TERM": 143}.get(how, code)
    assert seen.lit_s <= (said_s or 0.0) + held_s + STARVED_S, (how, seen.lit)
    if said_s is None and held_s == 0.0:
        assert not seen.lit
    if how != "kill" and not (how == "cable" and not seen.ends_dark):
        assert seen.ends_dark, child.said[-2000:]
    elif not seen.ends_dark and not on_the_mirror:  # nobody but the instrument itself can close it now
        assert seen.watchdogs_s[-1] == WATCHDOG_S
    for x_rad, y_rad in seen.lit_beams:
        assert math.atan(ALLOWED["left_m"] / 2) - MARGIN_RAD <= x_rad <= math.atan(ALLOWED["right_m"] / 2) + MARGIN_RAD
        assert math.atan(ALLOWED["bottom_m"] / 2) - MARGIN_RAD <= y_rad <= math.atan(ALLOWED["top_m"] / 2) + MARGIN_RAD


def test_a_stay_of_no_time_is_over_at_once_also_at_a_terminal(tmp_path: Path) -> None:
    path = bench_file(tmp_path, {})
    with at_a_terminal(tmp_path, "point", "0.2", "-0.1", "--hold", "0", "--bench", str(path)) as child:
        assert child.ends(240) == 0
        assert "(+0.2000, -0.1000) m on the wall" in child.said
