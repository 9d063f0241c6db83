"""Runs a demo program of PicoQuant's in front of the stand-in for its library.

run_demo.py DEVICE DEMO.py, in a folder of its own, where the demo leaves what it measured. Beside that comes
`ours.npz`: the histogram that the instrument counted, or the records that it handed over and their photons' pulses and
delays.
"""

import builtins
import contextlib
import ctypes
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.picoquant import library as stand_in
from nlos.drivers.tcspc.picoquant.families import FAMILIES, Family
from nlos.drivers.tcspc.t3 import T3Decoder

A_CALL_S = 5e-4
LASER_HZ = 10e6
NEVER_ASKED = {"GetNumOfInputChannels": 1, "GetWarnings": 0, "GetSyncPeriod": 1 / LASER_HZ}
"""By our driver; demos do, and are answered here."""


random = np.random.default_rng(7)


def light(gate: Gate, *_: Any) -> Exposure:
    """A peak at 12 ns, 40,000 photons a second."""
    times_s = gate.offset_s + gate.bin_width_s * (np.arange(gate.bins) + 0.5)
    shape = np.exp(-0.5 * ((times_s - 12e-9) / 0.3e-9) ** 2)
    counts = random.poisson(4e4 * gate.dwell_s * shape / max(shape.sum(), 1e-9)).astype(np.uint32)
    return Exposure(counts, gate.dwell_s, int(counts.sum()), 0, False)


class AsCtypesPasses:
    """The functions, for a host that passes numbers of ctypes and references to arrays. Time passes while it calls."""

    def __init__(self, functions: stand_in.PicoquantLibrary, bench: SimulatedBench) -> None:
        self._functions, self._bench = functions, bench
        self.records: list[int] = []
        self.reads = False

    def __getattr__(self, name: str) -> Callable[..., int]:
        bare = name.partition("_")[2]

        def call(*arguments: Any) -> int:
            # All records come at the end here, and a demo that hears of the end first reads no more.
            if not (bare == "CTCStatus" and self.reads):
                self._bench.clock.sleep(A_CALL_S)
            self.reads |= bare == "ReadFiFo"
            if bare in NEVER_ASKED:
                arguments[-1]._obj.value = NEVER_ASKED[bare]
                return 0
            given = [plain(each) for each in arguments]
            code = int(getattr(self._functions, name)(*given))
            if bare == "ReadFiFo" and code == 0:
                self.records += given[1][: given[-1]._obj.value]
            return code

        return call


def plain(argument: Any) -> Any:
    """As our adapter would pass it."""
    if isinstance(argument, ctypes.c_int | ctypes.c_uint):
        return argument.value
    under = getattr(argument, "_obj", None)
    return under if isinstance(under, ctypes.Array) else argument


def run(demo: Path, library: AsCtypesPasses, bench: SimulatedBench) -> None:
    """As `python DEMO.py` with RETURN and q at the keyboard; in T3 mode where the demo has a choice."""
    answers = iter(["", "q", "", ""])
    builtins.input = lambda *_: next(answers)
    time.sleep = bench.clock.sleep
    ctypes.CDLL = lambda *_: library  # type: ignore[misc, assignment]
    source = demo.read_text(encoding="utf-8").replace("mode = MODE_T2", "mode = MODE_T3")
    scope: dict[str, Any] = {"__name__": "__main__", "exit": sys.exit}
    with contextlib.suppress(SystemExit):
        exec(compile(source, demo, "exec"), scope)
    scope["outputfile"].close()  # as the end of a process does


def keep(records: list[int], functions: stand_in.PicoquantLibrary, family: Family) -> None:
    if not records:
        assert functions._counts is not None
        np.savez("ours.npz", histogram=functions._counts)
        return
    events = T3Decoder(family.layout).feed(np.asarray(records, np.uint32))
    np.savez("ours.npz", records=records, pulses=events.photon_pulses, delays=family.layout.delays(events.photons))


if __name__ == "__main__":
    device, program = sys.argv[1:]
    kind = FAMILIES[device]
    stand_in._TEXT_BYTES["OpenDevice"] = 8  # most demos reserve no more; ours must reserve 32, as a few do
    table = SimulatedBench(light)
    instrument = stand_in.PicoquantLibrary(table, device, LASER_HZ, version=f"3.{int(kind.prefix == 'MH')}")
    passed = AsCtypesPasses(instrument, table)
    run(Path(program), passed, table)
    keep(passed.records, instrument, kind)
