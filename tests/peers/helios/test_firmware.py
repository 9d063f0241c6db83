"""The simulated Helios firmware and the real one, told the same at the same times: answers, samples and marks alike."""

import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import open_bench
from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.helios.model import HELIOS
from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.helios.firmware import HeliosFirmware
from nlos.drivers.simulated.helios.outputs import Outputs
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.usb.pipes import SimulatedPipes
from tests.acquisition.test_own_clock import plan, settings

SETTINGS = HeliosSettings(model="helios", usb="simulated", markers="colours")
COMMANDS = 2500
Change = tuple[float, int, int, bytes]


def table(log: list[Change]) -> tuple[SimulatedBench, Outputs]:
    bench = SimulatedBench(lambda gate, beam, lit: Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False))
    outputs = Outputs(bench, SETTINGS)
    outputs.log = lambda *change: log.append(change)
    return bench, outputs


def deed(chance: random.Random) -> tuple[str, bytes]:
    """What a host may do next: any command but the one that erases, frames whole and damaged."""
    kind = chance.choice(["frame"] * 6 + ["command"] * 5 + ["damaged", "leave", "choose"])
    if kind == "command":
        return kind, bytes([chance.choice([1, 2, 3, 3, 3, 4, 5, 7, 9]), chance.choice([0, 0, 1])])
    colours = [bytes(4), bytes((255, 0, 0, 255)), bytes((0, 168, 0, 9))]
    samples = [
        wire.Codes(chance.randrange(4096), chance.randrange(4096), chance.choice(colours))
        for _ in range(chance.choice([1, 2, 3, 40]))
    ]
    frame = wire.encode_frame(samples, chance.choice([7, 333, 1000, 30_000, 65_535]), chance.randrange(4))
    if kind == "damaged":
        at = chance.randrange(len(frame) - 5, len(frame))
        return kind, frame[: -chance.randrange(1, 4)] if chance.random() < 0.5 else (
            frame[:at] + bytes([chance.randrange(256)]) + frame[at + 1 :]
        )
    return kind, frame


def test_random_commands_and_frames_are_answered_and_played_alike(real: Callable[..., object]) -> None:
    logs: list[list[Change]] = [[], []]
    (bench, outputs), (other, others) = table(logs[0]), table(logs[1])
    peers = HeliosFirmware(bench, SETTINGS, outputs), real(other, others)
    chance, now_s = random.Random(20260), 0.0
    for each in peers:
        each.connected(True, now_s)
    for step in range(COMMANDS):
        now_s += chance.choice([1e-4, 3e-3, 0.02, 0.05, 0.0999, 0.15])
        kind, data = deed(chance)
        said = []
        for each in peers:
            if kind == "command":
                said.append(each.command(data, now_s))
            elif kind in ("leave", "choose"):
                each.connected(kind == "choose", now_s)
            else:
                said.append(each.bulk(data, now_s))
        if kind == "command" and data[0] == 5 and said[1] is not None:
            said[1] = said[1].split(b"\0")[0].ljust(32, b"\0")  # what is behind the name was never set
        assert said[:1] == said[1:], (step, kind, data)
        assert peers[0].shutter_pin == peers[1].shutter_pin
    assert len(logs[0]) > COMMANDS
    assert [change[1:] for change in logs[0]] == [change[1:] for change in logs[1]]
    for ours, theirs in zip(*logs, strict=True):
        assert ours[0] == pytest.approx(theirs[0], abs=1e-6)


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.PLAYED])
@pytest.mark.parametrize("counter", ["tcspc488", "tcspc488 t3", "multiharp", "timetagger list"])
def test_a_scan_is_the_same_to_the_last_bit(
    monkeypatch: pytest.MonkeyPatch, real: Callable[..., object], counter: str, scheme: Scheme
) -> None:
    this, chosen = plan(counter), settings(counter)
    logs: list[list[Change]] = [[], []]
    scans = []
    for k in range(2):

        def far_end(mirror: HeliosSettings, table: SimulatedTable, k: int = k) -> SimulatedPipes:
            outputs = Outputs(table.bench, mirror)
            outputs.log = lambda *change: logs[k].append(change)
            device = real(table.bench, outputs) if k else HeliosFirmware(table.bench, mirror, outputs)
            return SimulatedPipes(device, table.bench, table.simulation.usb_latency_ms * 1e-3)

        monkeypatch.setitem(MIRRORS, "helios", replace(HELIOS, firmware=far_end))
        with open_bench(chosen) as bench:
            if not counter.startswith("tcspc488"):
                assert bench.simulated is not None
                bench.simulated.set_shutter(True)
            scans.append(list(scan(this, bench, scheme=scheme)))
    assert len(logs[0]) > len(this)
    assert [change[1:] for change in logs[0]] == [change[1:] for change in logs[1]]
    for ours, theirs in zip(*scans, strict=True):
        assert ours.point == theirs.point
        np.testing.assert_array_equal(ours.histogram.counts, theirs.histogram.counts)
    assert sum(int(sample.histogram.counts.sum()) for sample in scans[0]) > 1000
