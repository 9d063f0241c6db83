"""On a bench with any fault of docs/faults.md the thorough examination says so in the right line, or the fault is one
that the drivers put right by themselves."""

import os
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import pytest

from nlos.cli.benches import load_bench
from nlos.cli.terminal import terminal
from nlos.doctor import small_scan
from nlos.doctor.examination import Visit, examine
from nlos.doctor.findings import Finding
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.fault_catalogue import tables
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.faults import FAULTS as SERIAL
from nlos.drivers.tcspc.known_counters import COUNTERS

ROWS = {row.name: row for rows in tables().values() for row in rows}
BUILT_IN = {name for name, row in ROWS.items() if row.parameters.startswith("built in")}
AS_OPENED = 0.0
SOAK = os.environ.get("NLOS_SOAK") == "1"


@dataclass
class Case:
    """The bench, when the fault begins and how often it strikes, and the line in which it is said; None: in none."""

    line: str | None
    verdict: str = "FAIL"
    bench: str = "simulated"
    after_s: float = 0.03
    times: int = 400
    parameters: dict[str, Any] = field(default_factory=dict)
    beside: tuple[Fault, ...] = ()
    counter: dict[str, Any] = field(default_factory=dict)

    def elsewhere(self, line: str) -> "Case":
        """The same, seen in another line, where it is the end of the examination."""
        return replace(self, line=line, verdict="FAIL")


def _optotune(line: str | None, **words: Any) -> Case:
    return Case(line, bench="optotune", after_s=0.13, **words)


def _multiharp(line: str | None, verdict: str = "FAIL", **words: Any) -> Case:
    return Case(line, verdict, bench="multiharp", after_s=0.23, **words)


def _timetagger(line: str | None, verdict: str = "FAIL", **words: Any) -> Case:
    return Case(line, verdict, bench="timetagger", after_s=0.23, **words)


def _helios(line: str | None, verdict: str = "FAIL", **words: Any) -> Case:
    return Case(line, verdict, bench="helios", **words)


CASES = {
    **{name: Case("links") for name in ("G1", "G2", "G4", "G5", "G6", "G8", "G9", "A2", "A7")},
    **{name: Case(None) for name in ("G3", "G7", "U7", "U8", "U16")},
    "G10": Case("mirror", after_s=AS_OPENED),
    "A3": Case("mirror", after_s=AS_OPENED),
    "A4": Case("markers"),
    "A6": Case("markers"),
    "A8": Case(None, after_s=AS_OPENED),
    "A9": Case(None, after_s=AS_OPENED),
    "B1": _optotune("mirror"),
    "B2": _optotune("mirror"),
    "B3": _optotune(None),
    "B4": _optotune("mirror"),
    "B5": _optotune("corners"),
    "B6": _optotune("corners"),
    **{name: Case("counter") for name in ("U1", "U3", "U5", "U10", "U11", "U13", "U18")},
    "U2": Case("markers"),
    "U4": Case("counter", parameters={"replies": 400}, beside=(Fault(name="U1", after_s=0.03, times=400),)),
    "U6": Case("counter", parameters={"what": "cut", "size": 3}),
    "U12": Case("markers", "WARN"),
    "U14": Case("markers"),
    "U15": Case("markers"),
    "U17": Case("counter", after_s=AS_OPENED),
    "U19": Case("links", "WARN", after_s=AS_OPENED, times=200, parameters={"delay_s": 0.1}),
    "U20": Case("markers", "WARN", counter={"mode": "t3"}, parameters={"place": "records", "what": "fifo_full"}),
    "H1": _helios("markers", parameters={"place": "sequence"}),
    "H2": _helios("markers", parameters={"place": "marker_1"}),
    "H3": _helios("mirror", after_s=0.5, parameters={"place": "command"}),
    "H4": _helios("mirror", after_s=0.5),
    "T1": _timetagger("markers", "WARN"),
    "T2": _timetagger("markers", parameters={"place": "sync"}),
    "T4": Case("markers", bench="timetagger", after_s=0.7),
    "V1": _multiharp("counter"),
    "V2": _multiharp("markers", "WARN"),
    "V3": _multiharp("markers"),
    "V4": _multiharp("markers"),
}  # fmt: skip
REPEATED = {
    **{name: Case("repeats") for name in ("U1", "U3", "U5", "U10")},
    "U6": Case("repeats", parameters={"what": "cut", "size": 3}),
    "U12": Case("repeats"),
    "A4": Case("repeats"),
    "B5": _optotune("repeats", parameters={"place": "damaged"}),
}
BENCHES = ("simulated", "zero_latency", "noisy", "moving", "drawn", "optotune", "multiharp", "timetagger", "helios")
"""All that ship with a simulation."""
ELSEWHERE = {
    **{("optotune", name): Case("mirror") for name in ("G1", "G2", "G4", "G5", "G6", "G9")},  # met as it moves
    **{("optotune", name): CASES[name].elsewhere("dark histogram") for name in ("U2", "U12", "U14", "U15", "U20")},
    ("timetagger", "T2"): CASES["T2"].elsewhere("counter"),
    ("helios", "U15"): CASES["U15"].elsewhere("dark histogram"),
    ("multiharp", "U20"): Case(None, parameters={"place": "marker"}),
}
"""What another bench than a fault's own says: one whose mirror cannot step by itself has no line of markers."""
SAMPLE = ("G8", "G10", "A6", "B6", "U11", "U12", "U14", "V3")
"""One of each kind: what every change is tested with."""


def thorough(settings: BenchSettings) -> list[Finding]:
    table = replace(load_bench(None), settings=settings)
    return list(examine(table, Visit(lambda bench: True, None, thorough=True)))


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """No reconstruction at the end of each of so many examinations, and nothing on the terminal."""
    monkeypatch.setattr(small_scan, "_reconstruction", lambda *about: iter(()))
    monkeypatch.setattr(terminal, "verbosity", -9)


def settings_of(case: Case, *faults: Fault) -> BenchSettings:
    chosen = load_bench(case.bench).settings
    assert chosen.simulation is not None
    counter = chosen.counter.model_copy(update=case.counter)
    simulation = chosen.simulation.model_copy(update={"faults": faults})
    return chosen.model_copy(update={"simulation": simulation, "counter": counter})


def test_every_fault_has_its_case() -> None:
    assert set(CASES) == set(ROWS) - BUILT_IN
    for name, case in CASES.items():
        if case.line is None:
            assert ROWS[name].seen.startswith("nothing"), f"{name} is to be seen"


@pytest.mark.soak
@pytest.mark.parametrize("name", CASES if SOAK else SAMPLE)
def test_the_right_line_says_so(name: str) -> None:
    check(CASES[name], name)


def check(case: Case, name: str) -> None:
    """Examines the bench with the fault; the line says so, or where there is none, nothing does."""
    fault = Fault(name=name, after_s=case.after_s, times=case.times, parameters=case.parameters)
    beside = [each.model_copy(update={"after_s": case.after_s}) for each in case.beside]
    findings = thorough(settings_of(case, fault, *beside))
    said = [(each.verdict, each.what) for each in findings if each.verdict in ("WARN", "FAIL")]
    if case.line is not None:
        assert (case.verdict, case.line) in said, said
    else:
        healthy = [(each.verdict, each.what) for each in thorough(settings_of(case))]
        assert set(said) <= set(healthy), said


def crossed() -> list[tuple[str, str]]:
    """Every bench that ships, and every fault that what it names can commit."""
    found = []
    for bench in BENCHES:
        settings = load_bench(bench).settings
        rows = [*MIRRORS[settings.mirror.model].faults, *COUNTERS[settings.counter.model].faults]
        names = {row.name for row in (*rows, *(SERIAL if settings.mirror.cable == "serial" else ()))} - BUILT_IN
        if settings.counter.model == "picoquant":
            names.add("U20")
        found += [(bench, name) for name in sorted(names)]
    return found


@cache
def opened_s(bench: str) -> float:
    """What the bench's clock says once it is open."""
    with open_bench(load_bench(bench).settings) as table:
        return table.clock.now()


@pytest.mark.soak
@pytest.mark.parametrize(("bench", "name"), crossed() if SOAK else [("timetagger", "A6"), ("optotune", "U14")])
def test_on_every_bench_the_right_line_says_so(bench: str, name: str) -> None:
    case = ELSEWHERE.get((bench, name), CASES[name])
    later_s = 0.5 if case.after_s == 0.5 else 0.005
    after_s = AS_OPENED if case.after_s == AS_OPENED else opened_s(bench) + later_s
    check(replace(case, bench=bench, after_s=after_s), name)


@pytest.mark.soak
@pytest.mark.parametrize("name", REPEATED if SOAK else ["U5", "B5"])
def test_what_the_drivers_put_right_by_asking_again_is_a_warning(name: str) -> None:
    case = REPEATED[name]
    fault = Fault(name=name, after_s=case.after_s, times=1, parameters=case.parameters)
    said = [
        (each.verdict, each.what) for each in thorough(settings_of(case, fault)) if each.verdict in ("WARN", "FAIL")
    ]
    assert said == [("WARN", "repeats")], said


def test_nothing_is_repeated_on_a_healthy_bench() -> None:
    (line,) = (each for each in thorough(settings_of(Case(None))) if each.what == "repeats")
    assert line.verdict == "PASS"
