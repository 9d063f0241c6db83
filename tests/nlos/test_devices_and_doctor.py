"""`nlos devices` and `nlos doctor`: what they say about a bench that is there, one that is not, and one that is ill."""

import json
from pathlib import Path
from typing import Any

import pytest
import usb.backend.libusb1
import yaml

from nlos.__main__ import run
from nlos.cli.terminal import terminal
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb


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
