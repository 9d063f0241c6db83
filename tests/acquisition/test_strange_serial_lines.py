"""Serial lines that become strange and stay so: a scan on them is complete and right, or ends dark with a sentence, as
the table itself says."""

import random
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

import nlos
from nlos.drivers.errors import DeviceError
from nlos.drivers.simulated.serial.cable import SerialCable
from tests.acquisition.witnessed_bench import bench_file, witnessed

SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 2
histogram: {bins: 64, bin_width_ps: 256, offset_ns: 10}
"""
FROM = 60
"""Messages either way: in the midst of the scan."""
Pieces = Iterable[tuple[float, bytes]]
Line = Callable[[str, bytes], Pieces]


def shared(way: str, data: bytes) -> Pieces:
    """Another program takes every second byte of what arrives."""
    return [(0.0, data if way == ">" else data[::2])]


def halved() -> Line:
    """Another program takes every second answer."""
    draw = random.Random(0)
    return lambda way, data: [(0.0, data)] if way == ">" or draw.random() < 0.5 else []


def behind() -> Line:
    """Each answer is that of the command before."""
    held = b""

    def line(way: str, data: bytes) -> Pieces:
        nonlocal held
        if way == ">":
            return [(0.0, data)]
        late, held = held, data
        return [(0.0, late)]

    return line


def misread() -> Line:
    """A wrong baud rate: garbage that sometimes is an answer."""
    draw = random.Random(0)
    return lambda way, data: [
        (0.0, data if way == ">" else bytes(draw.choice((0, 0x80, 0xFF, 0x0D, 0x0A, each)) for each in data))
    ]


def buffered(way: str, data: bytes) -> Pieces:
    """An adapter that keeps answers back for 16 ms."""
    return [(0.016 if way == "<" else 0.0, data)]


def without_flow_control_bytes(way: str, data: bytes) -> Pieces:
    return [(0.0, data.translate(None, b"\x11\x13"))]


def doubled(way: str, data: bytes) -> Pieces:
    return [(0.0, data), (0.003, data)] if way == "<" else [(0.0, data)]


LINES: dict[str, Callable[[], Line]] = {
    "shared": lambda: shared, "halved": halved, "behind": behind, "misread": misread, "buffered": lambda: buffered,
    "without XON and XOFF": lambda: without_flow_control_bytes, "doubled": lambda: doubled,
}  # fmt: skip
HARMLESS = {"buffered", "without XON and XOFF"}


def scanned(folder: Path, name: str) -> dict[int, bytes]:
    (folder / "scan.yaml").write_text(SCAN)
    with nlos.open_bench(bench_file(folder, name)) as bench:
        samples = nlos.scan(folder / "scan.yaml", bench)
        return {sample.point.number: sample.histogram.counts.tobytes() for sample in samples}


def is_dark(folder: Path) -> bool:
    return [line for line in witnessed(folder) if line.startswith("shutter")][-1:] in ([], ["shutter closed"])


def strange(monkeypatch: pytest.MonkeyPatch, line: Line) -> None:
    begin, messages = SerialCable.__init__, 0

    def mangle(way: str, data: bytes) -> Pieces:
        nonlocal messages
        messages += 1
        return line(way, data) if messages >= FROM else [(0.0, data)]

    def plugged(self: SerialCable, *arguments: object) -> None:
        begin(self, *arguments)  # type: ignore[arg-type]
        self.mangle = mangle

    monkeypatch.setattr(SerialCable, "__init__", plugged)


@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("name", ["S1, TTL shutter", "S1"])
def test_a_scan_on_a_strange_line_is_right_or_ends_dark(
    tmp_path: Path, name: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = scanned(tmp_path, name)
    strange(monkeypatch, LINES[kind]())
    if kind in HARMLESS:
        assert scanned(tmp_path, name) == whole
    else:
        with pytest.raises(DeviceError, match=r"^(triggerscope|optotune): .*(Check|open the bench again)"):
            scanned(tmp_path, name)
    assert is_dark(tmp_path)


@pytest.mark.parametrize("first", [1, FROM])
@pytest.mark.parametrize("name", ["S1, TTL shutter", "S1"])
def test_a_port_that_echoes_is_named_as_one(
    tmp_path: Path, name: str, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    send, sent = SerialCable.send, 0

    def echoing(self: SerialCable, data: bytes) -> None:
        nonlocal sent
        sent += 1
        if sent >= first:
            self.say(data)
        send(self, data)

    monkeypatch.setattr(SerialCable, "send", echoing)
    with pytest.raises(DeviceError, match=r"back as it was sent\. Turn off the local echo"):
        scanned(tmp_path, name)
    assert is_dark(tmp_path)
