"""The table of faults is what the simulators commit, what the tests provoke, and what the page says."""

import json
import re
from pathlib import Path

import pytest
import yaml

from nlos.configs.load import ConfigError, load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.simulated.fault_catalogue import markdown, refusal, tables
from nlos.drivers.simulated.faults import Fault, one_of
from tests.acquisition.fault_cases import BENCHES

TOP = Path(__file__).parents[3]
NAMES = {row.name for rows in tables().values() for row in rows}
BUILT_IN = {row.name for rows in tables().values() for row in rows if row.parameters.startswith("built in")}
NAMED = re.compile(r'"([GABUVHT]\d{1,2})"')


def named_in(folder: Path, but: str) -> set[str]:
    return {
        name for path in folder.rglob("*.py") if path.name != but for name in NAMED.findall(path.read_text("utf-8"))
    }


def test_the_page_is_made_from_the_table() -> None:
    page = (TOP / "docs" / "faults.md").read_text("utf-8")
    assert page == markdown(), "run: python -m nlos.drivers.simulated.fault_catalogue > docs/faults.md"


def test_every_fault_of_the_table_can_be_committed_and_no_other() -> None:
    named = named_in(TOP / "drivers" / "simulated", "faults.py")
    assert named - {"U32", "T3"} == NAMES - BUILT_IN  # which are a record format and a mode


@pytest.mark.parametrize("name", sorted(NAMES - BUILT_IN))
def test_every_fault_is_provoked_by_a_test(name: str) -> None:
    assert name in named_in(TOP / "tests", "test_fault_catalogue.py")


def test_a_fault_that_nobody_knows_is_refused() -> None:
    bench = load("bench", "simulated", BenchSettings).settings.model_dump(mode="json")
    with pytest.raises(ValueError, match=r"no fault of that name: G11\. .*fault_catalogue` prints all"):
        BenchSettings.model_validate_json(json.dumps(bench | {"simulation": {"faults": [{"name": "G11"}]}}))


@pytest.mark.parametrize(
    ("name", "parameters", "why"),
    [
        ("G2", {"delay_ms": 5}, "fault G2 has no parameter delay_ms; it takes: `delay_s`"),
        ("A6", {"missed": True}, "fault A6 has no parameter missed; it takes: `kind`"),
        ("G8", {"flush": True}, "fault G8 has no parameter flush; it takes: `place`"),
        ("G1", {"delay_s": 5}, "fault G1 has no parameter delay_s; it takes: none"),
        ("A6", {"kind": "mised"}, "has no parameter kind: mised; it takes: `kind`: `missed`, `extra`"),
        ("U20", {"place": "markers"}, "has no parameter place: markers; it takes: tcspc488: `place`: `records`"),
        ("U11", {"place": "read", "replug_s": 1, "error": "io"}, "U11 has no parameter replug_s; it takes: `place`: "),
        *[(name, parameters, "") for name, parameters in [
            ("B1", {"reply": "NO"}), ("G8", {"place": "any call", "replug_after_s": 0.1}), ("U6", {"what": "cut"}),
            ("U20", {"place": "marker", "late_pulses": 3}), ("U20", {"place": "block", "what": "fifo_full"}),
            ("V1", {"place": "MH_StartMeas", "code": -1}), ("G7", {"chunk": 0, "gap_s": 0.1}),
        ]],
    ],
)  # fmt: skip
def test_parameters_that_a_fault_does_not_have(name: str, parameters: dict[str, object], why: str) -> None:
    said = refusal(Fault(name=name, parameters=parameters))
    assert (why in said) if why else not said


def test_every_fault_of_the_campaigns_has_the_parameters_that_they_ask_for() -> None:
    asked = [Fault(name=name, parameters=given) for _, _, some in BENCHES.values() for name, given in some]
    assert len(asked) > 60
    assert [said for fault in asked if (said := refusal(fault))] == []


def test_every_parameter_is_written_in_a_bench_file_as_the_table_writes_it() -> None:
    words = {word for rows in tables().values() for row in rows for word in re.findall(r"`(\w+)`", row.parameters)}
    assert len(words) > 30
    assert [word for word in words if yaml.safe_load(f"{{{word}: 1}}") != {word: 1}] == []


def test_a_parameter_of_another_kind_is_refused_by_its_name() -> None:
    given = Fault(name="B4", parameters={"bit": "hot", "delay_s": 2, "cause": "heat"}).parameters
    assert given.get("delay_s", 1.0) == 2
    with pytest.raises(ConfigError, match=r"parameters: bit: write a number \(given 'hot'\)"):
        given.get("bit", 1)
    with pytest.raises(ConfigError, match=r"parameters: cause: write one of interlock, sync \(given 'heat'\)"):
        one_of(given, "cause", "sync", ["sync", "interlock"])
