"""`nlos devices` and `nlos doctor`: what they say about a bench that is there, one that is not, and one that is ill."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
import usb.backend.libusb1
import usb.core
import yaml

from nlos.__main__ import run
from nlos.cli.terminal import terminal
from nlos.configs.load import load
from nlos.doctor.instruments import dark_line, shutter
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.tcspc.counter import CountRates


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


def bench_file(folder: Path, name: str = "simulated", **changes: Any) -> str:
    document = yaml.safe_load((Path(__file__).parents[2] / "configs" / "bench" / f"{name}.yaml").read_text("utf-8"))
    for key, value in changes.items():
        document[key] = {**document[key], **value} if isinstance(value, dict) else value
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return str(path)


def test_a_simulated_bench_is_all_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["devices", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [item["model"] for item in said["expected"]] == ["triggerscope", "tcspc488"]
    assert all(item["found"] for item in said["expected"])


def test_a_simulated_instrument_that_is_missing_is_named_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = yaml.safe_load(Path(bench_file(tmp_path)).read_text("utf-8"))
    document["simulation"]["faults"] = [{"name": "G10", "parameters": {"kind": "missing"}}]
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(document), "utf-8")
    assert run(["devices", "--bench", str(tmp_path / "bench.yaml")]) == 3
    said = capsys.readouterr().out
    assert "MISSING  mirror triggerscope at sim://triggerscope: there is no port" in said
    assert "there    counter tcspc488" in said


def test_what_a_real_bench_misses_is_named_with_its_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_file(tmp_path, "lab", mirror={"port": str(tmp_path / "ttyACM7")})
    assert run(["devices", "--bench", path]) == 3
    said = capsys.readouterr().out
    assert "MISSING  mirror triggerscope" in said
    assert "MISSING  counter tcspc488" in said
    assert "Plug it in" in said


def test_a_wire_log_of_a_real_bench_is_begun_though_nothing_is_said_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "wire_log_begun", False)
    path, log = bench_file(tmp_path, "lab", mirror={"port": str(tmp_path / "ttyACM7")}), tmp_path / "wire.log"
    assert run(["devices", "--bench", path, "--wire-log", str(log)]) == 3
    assert log.read_bytes() == b""
    assert f"{log}: every byte" in capsys.readouterr().err
    monkeypatch.setattr(terminal, "wire_log_begun", False)
    assert run(["devices", "--bench", path, "--wire-log", str(log)]) == 6
    assert "exists" in capsys.readouterr().err


def test_a_port_that_is_not_ours_comes_with_a_udev_rule(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tmp_path / "ttyACM7"
    port.touch()
    monkeypatch.setattr("os.access", lambda path, mode: False)
    assert run(["devices", "--bench", bench_file(tmp_path, "lab", mirror={"port": str(port)})]) == 3
    assert 'SYMLINK+="triggerscope", TAG+="uaccess"' in capsys.readouterr().out


def test_an_absent_vendor_library_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    counter = {"model": "picoquant", "device": "hydraharp400", "library": "vendor"}
    document = yaml.safe_load(Path(bench_file(tmp_path, "lab")).read_text("utf-8"))
    document |= {"counter": counter, "shutter": {"model": "none"}}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(document), "utf-8")
    assert run(["devices", "--bench", str(tmp_path / "bench.yaml")]) == 3
    assert "libhh400.so" in capsys.readouterr().out


def test_the_doctor_passes_the_simulated_bench(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["FAIL"] == 0
    examined = {finding["what"] for finding in said["findings"]}
    assert examined >= {"software", "disk", "links", "mirror", "counter", "shutter", "dark counts", "scan"}


def test_the_doctor_of_a_new_bench_warns_of_no_wall_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = str(tmp_path / "lab.yaml")
    assert run(["new", "bench", "--simulated", "--no-check", "-o", lab]) == 0
    assert run(["doctor", "--bench", lab]) == 0
    told = capsys.readouterr()
    assert " 0 WARN, 0 FAIL" in told.out + told.err
    assert "warning" not in told.out + told.err


def test_the_doctor_sees_a_hot_detector(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = yaml.safe_load(Path(bench_file(tmp_path)).read_text("utf-8"))
    document["simulation"]["detector"]["dark_cps"] = 100_000.0
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(document), "utf-8")
    assert run(["doctor", "--bench", str(tmp_path / "bench.yaml")]) == 3
    assert "FAIL  dark counts" in capsys.readouterr().out


def test_the_doctor_names_all_that_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_file(tmp_path, "lab", mirror={"port": str(tmp_path / "ttyACM7")})
    assert run(["doctor", "--bench", path]) == 3
    said = capsys.readouterr().out
    assert "FAIL  triggerscope" in said
    assert "FAIL  tcspc488" in said


def faulty(folder: Path, *faults: dict[str, Any], **changes: Any) -> str:
    """The simulated bench with faults."""
    document = yaml.safe_load(Path(bench_file(folder, **changes)).read_text("utf-8"))
    document["simulation"]["faults"] = list(faults)
    (folder / "bench.yaml").write_text(yaml.safe_dump(document), "utf-8")
    return str(folder / "bench.yaml")


def examined(capsys: pytest.CaptureFixture[str], *words: str, ends: int = 3) -> dict[str, list[str]]:
    """Line -> its verdicts."""
    capsys.readouterr()
    assert run(["doctor", "--json", *words]) == ends
    said: dict[str, list[str]] = {}
    for finding in json.loads(capsys.readouterr().out)["findings"]:
        said.setdefault(finding["what"], []).append(finding["verdict"])
    return said


def test_without_its_mirror_the_doctor_examines_counter_and_shutter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = examined(capsys, "--bench", faulty(tmp_path, {"name": "G10", "times": 9, "parameters": {"kind": "missing"}}))
    assert said["mirror"] == ["FAIL", "SKIP"]
    assert said["shutter"] == said["counter"] == said["sync"] == said["dark counts"] == ["PASS"]
    assert said["links"] == said["scan"] == ["SKIP"]


def test_without_its_counter_the_doctor_moves_no_mirror_that_may_be_in_the_light(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fault = {"name": "U17", "times": 9, "parameters": {"what": "busy"}}
    said = examined(capsys, "--bench", faulty(tmp_path, fault))
    assert said["counter"] == ["FAIL", "SKIP"]
    assert said["shutter"] == ["FAIL"]
    assert said["mirror"] == said["dark counts"] == ["SKIP"]
    other = {"mirror": {"shutter_pin": 9}, "shutter": {"model": "triggerscope_ttl"}}
    said = examined(capsys, "--bench", faulty(tmp_path, fault, **other))
    assert said["counter"] == ["FAIL", "SKIP"]
    assert said["shutter"] == ["PASS"]
    assert said["mirror"] == ["PASS", "PASS"]


def test_a_ttl_shutter_is_given_no_remedy_that_it_has_no_input_for(tmp_path: Path) -> None:
    file = bench_file(tmp_path, mirror={"shutter_pin": 9}, shutter={"model": "triggerscope_ttl"})
    with open_bench(load("bench", file, BenchSettings).settings) as bench:
        contact, watchdog = shutter(bench)
    assert "has no input for a contact" in contact.remedy
    assert "a thread of it closes the shutter after 2 s" in watchdog.said


def test_a_check_that_fails_takes_only_those_along_that_need_the_same_instrument(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = examined(capsys, "--bench", faulty(tmp_path, {"name": "G1", "after_s": 0.03, "times": 99}))
    assert said["links"] == ["FAIL"]
    assert said["counter"] == said["sync"] == said["dark counts"] == ["PASS"]
    assert said["mirror"][0] == said["scan"][0] == "SKIP"


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "allowed",
    [
        {"left_m": -0.1, "right_m": 0.05, "bottom_m": -0.2, "top_m": 0.2},
        {"left_m": 0.1, "right_m": 0.4, "bottom_m": -0.5, "top_m": -0.2},
        {"left_m": -9.0, "right_m": 9.0, "bottom_m": -9.0, "top_m": 9.0},
    ],
)
def test_the_doctor_aims_at_nothing_that_the_bench_does_not_allow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], allowed: dict[str, float]
) -> None:
    aimed: list[tuple[float, float]] = []
    witness = tmp_path / "witness"
    path = faulty(tmp_path, geometry={"allowed": allowed}, simulation={"witness": str(witness)})
    examined(capsys, "--bench", path, ends=0)
    for line in witness.read_text().splitlines():
        when_s, _, what = line.partition(" ")
        if what.startswith("beam to") and float(when_s) > 0.03:  # as it is opened the head swings out, in the dark
            aimed.append(tuple(map(float, what.split()[2:])))  # type: ignore[arg-type]
    moves = [(2 * math.tan(x), 2 * math.tan(y)) for x, y in aimed if math.hypot(x, y) > 1e-4]
    assert moves
    # One axis moves after the other, to or from the centre.
    for x, y in moves:
        assert min(allowed["left_m"], 0.0) - 0.01 <= x <= max(allowed["right_m"], 0.0) + 0.01
        assert min(allowed["bottom_m"], 0.0) - 0.01 <= y <= max(allowed["top_m"], 0.0) + 0.01


@pytest.mark.parametrize("verb", ["devices", "doctor"])
def test_a_counter_of_another_serial_number_is_not_taken_for_the_one_that_is_named(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    verb: str,
) -> None:
    dark = SimulatedBench(lambda *exposure: pytest.fail("nobody asked for light"))
    plugged_in = SimulatedUsb([Tcspc488Firmware(dark, serial="SIM0007")], dark.clock)
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda find_library=None: plugged_in)
    assert run([verb, "--bench", bench_file(tmp_path, "lab", counter={"usb": "SIM0001"})]) == 3
    assert "another one is plugged in: SIM0007" in capsys.readouterr().out


@pytest.mark.parametrize("converted", [False, True])
def test_the_doctor_asks_for_divider_and_stretcher_before_anything_is_opened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], converted: bool
) -> None:
    document = yaml.safe_load(Path(bench_file(tmp_path, "multiharp")).read_text("utf-8"))
    document["mirror"]["port"] = str(tmp_path / "ttyACM7")
    document["counter"] |= {"library": str(tmp_path / "libmh150.so"), "levels_converted": converted}
    del document["simulation"]
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(document), "utf-8")
    assert run(["doctor", "--bench", str(tmp_path / "bench.yaml"), "--json"]) == 3
    findings = json.loads(capsys.readouterr().out)["findings"]
    asked = [finding for finding in findings if finding["what"] == "levels"]
    if converted:
        assert not asked
        return
    assert [finding["verdict"] for finding in asked] == ["WARN", "WARN"]
    assert "5 V" in asked[0]["said"]
    assert "3.3 V at most: is there a divider" in asked[0]["said"]
    assert "NIM" in asked[1]["said"]
    assert "at least 10 us" in asked[1]["said"]
    assert findings.index(asked[0]) < [finding["verdict"] for finding in findings].index("FAIL")


def test_the_doctor_asks_for_no_divider_where_none_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("lab", "simulated", "multiharp"):  # another counter, and nothing real to damage
        run(["doctor", "--bench", bench_file(tmp_path, name), "--json"])
        findings = json.loads(capsys.readouterr().out)["findings"]
        assert not [finding for finding in findings if finding["what"] == "levels"]


@pytest.mark.parametrize(("dark_cps", "room_cps", "first"), [
    (2000.0, 20_000.0, "Dim the room: at first light dark counts were 2000/s, room light 20000/s."),
    (9000.0, 300.0, "Cool the detector: at first light dark counts were 9000/s, room light 300/s."),
    (None, None, "Dim the room, or cool the detector; `nlos calibrate --first-light` tells the two apart."),
])  # fmt: skip
def test_what_first_light_told_apart_the_doctor_knows(
    dark_cps: float | None, room_cps: float | None, first: str
) -> None:
    known = FirstLightSettings(delay_ns=0.35, direct_cps=40e3, dark_cps=dark_cps, room_cps=room_cps)
    found = dark_line(CountRates(10e6, 22e3), known)
    assert (found.verdict, found.remedy) == ("WARN", first)


def test_a_window_that_misses_the_direct_light_is_named_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not a second time as a shutter that was closed, which it was not."""
    document = yaml.safe_load(Path(bench_file(tmp_path)).read_text("utf-8"))
    document["simulation"]["scene"]["delay_ns"] = 47.0
    run(["doctor", "--bench", bench_file(tmp_path, simulation=document["simulation"])])
    said = capsys.readouterr().out
    assert "WARN  direct light" in said
    assert "Was the shutter closed?" not in said
    assert "SKIP  reconstruction" in said


def test_a_computer_without_libusb_is_told_what_it_cannot_open(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = usb.core.find

    def simulated_alone(**sought: Any) -> Any:
        if sought.get("backend") is None:
            raise usb.core.NoBackendError("No backend available")
        return find(**sought)

    monkeypatch.setattr(usb.core, "find", simulated_alone)
    assert run(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "WARN  software" in said
    assert "Only simulated USB instruments can be opened" in said
    assert "Install libusb-1.0" in said
