"""Ports that do not answer, told apart; a real mirror that does not move unless somebody agrees; a bench half there."""

import contextlib
import os
import select
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from nlos.__main__ import run
from nlos.acquisition.errors import StorageError
from nlos.cli.terminal import terminal
from nlos.configs.load import find, load
from nlos.doctor.silence import why_silent
from nlos.doctor.small_scan import small_scan
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceBusy, DeviceTimeout
from nlos.drivers.galvo.triggerscope.settings import TriggerScopeSettings
from nlos.drivers.link.port_owner import owners_of, usb_nodes
from nlos.drivers.link.serial_line import PortInfo

SILENT = DeviceTimeout("triggerscope", "no answer.")


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


@contextlib.contextmanager
def port(says: bytes) -> Iterator[str]:
    """A pseudo-terminal at whose far end something says the same to everything."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    over = threading.Event()

    def answer() -> None:
        while not over.is_set():
            if select.select([ours], [], [], 0.05)[0]:
                with contextlib.suppress(OSError):
                    os.read(ours, 1000)
                    os.write(ours, says)

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        thread.join()
        os.close(ours)
        os.close(theirs)


def mirror_at(path: str) -> TriggerScopeSettings:
    return TriggerScopeSettings(model="triggerscope", port=path)


def test_a_silent_port_and_one_that_speaks_another_language_are_told_apart() -> None:
    with port(b"") as path:
        assert "nothing at all comes from" in why_silent(mirror_at(path), SILENT, [])
    with port(b"Marlin 1.0 ready\r\n") as path:
        said = why_silent(mirror_at(path), SILENT, [])
        assert "answers b'Marlin" in said
        assert "wrong firmware" in said


def test_a_port_of_another_device_is_named_with_the_one_that_may_be_right() -> None:
    ports = [
        PortInfo("/dev/ttyACM0", "Arduino Uno", "1", 0x2341),
        PortInfo("/dev/ttyACM1", "Teensy", "2", 0x16C0),
        PortInfo("/dev/ttyS0", "", ""),
    ]
    said = why_silent(mirror_at("/dev/ttyACM0"), SILENT, ports)
    assert "wrong port: /dev/ttyACM0 is Arduino Uno (USB vendor 2341)" in said
    assert "/dev/ttyACM1" in said
    assert "/dev/ttyS0" not in said


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="asks Linux who holds a file")
def test_the_program_that_owns_a_port_is_named_with_its_number() -> None:
    with port(b"") as path:
        holds = f"import os; file = os.open({path!r}, os.O_RDWR | os.O_NOCTTY); print(1, flush=True); input()"
        with subprocess.Popen(
            [sys.executable, "-c", holds], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as other:
            assert other.stdout is not None
            assert other.stdout.readline()
            (owner,) = [each for each in owners_of(path) if f"(PID {other.pid})" in each]
            for error in (SILENT, DeviceBusy("triggerscope", "held.")):
                said = why_silent(mirror_at(path), error, [])
                assert f"owned by another program, {owner}" in said
            other.communicate("\n", timeout=10)


def test_usb_devices_are_found_by_what_the_kernel_says_of_them(tmp_path: Path) -> None:
    for name, text in (("idVendor", "1209"), ("idProduct", "0001"), ("busnum", "3"), ("devnum", "17")):
        (tmp_path / "3-1").mkdir(exist_ok=True)
        (tmp_path / "3-1" / name).write_text(text + "\n")
    (tmp_path / "usb1").mkdir()
    assert usb_nodes(0x1209, 1, tmp_path) == ["/dev/bus/usb/003/017"]
    assert usb_nodes(0x1209, 2, tmp_path) == []


def real_bench(folder: Path, path: str) -> str:
    text = find("bench", "lab").read_text("utf-8")
    file = folder / "real.yaml"
    file.write_text(text.replace("/dev/ttyACM0", path).replace("model: tcspc488\ngeometry", "model: none\ngeometry"))
    load("bench", str(file), BenchSettings)
    return str(file)


def test_the_doctor_goes_on_without_the_counter_but_moves_no_real_mirror_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with port(b"Marlin\r\n") as path:
        assert run(["doctor", "--bench", real_bench(tmp_path, path)]) == 3
        said = capsys.readouterr().out
        assert "FAIL  tcspc488" in said
        assert "SKIP  mirror" in said
        assert "nobody agreed" in said
        assert run(["doctor", "--bench", real_bench(tmp_path, path), "--move"]) == 3
        said = capsys.readouterr().out
        assert f"triggerscope at {path}" in said
        assert "wrong firmware" in said


def test_a_full_folder_for_temporary_files_fails_the_small_scan_and_no_other_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> Path:
        raise StorageError("doctor.h5: cannot reserve 1 MB. Choose another place with -o.") from OSError(28, "full")

    monkeypatch.setattr("nlos.acquisition.recording.writer.lay_out", refused)
    with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
        (found,) = small_scan(bench)
    assert (found.verdict, found.what) == ("FAIL", "scan")
    assert "TMPDIR" in found.remedy
    assert " -o" not in found.said
