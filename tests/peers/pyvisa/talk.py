"""Run by the foreign environment: pyvisa-py as host of the simulated `tcspc488`. Prints what went wrong, and a count.

talk.py PACKET_BYTES
"""

import sys

import numpy as np
import pyvisa
import usb.backend.libusb1

from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb

NAME = "USB0::0x1209::0x0001::SIM0001::0::INSTR"
NO_ERROR = '0,"No error"'


def opened(packet_bytes: int) -> tuple[SimulatedBench, pyvisa.resources.MessageBasedResource]:
    bench = SimulatedBench(lambda gate, beam, lit: Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False))
    bus = SimulatedUsb([Tcspc488Firmware(bench, packet_bytes=packet_bytes)], bench.clock)
    usb.backend.libusb1.get_backend = lambda find_library=None: bus
    instrument = pyvisa.ResourceManager("@py").open_resource(NAME, read_termination="\n", write_termination="\n")
    return bench, instrument


def answers_of_every_length(instrument: pyvisa.resources.MessageBasedResource, packet_bytes: int) -> int:
    """Blocks of 0 to three packets, with one to four digits behind them, so that every length occurs."""
    asked = 0
    for values in range(1, 3 * packet_bytes // 4):
        sent = list(range(1000, 1000 + values))
        instrument.write_binary_values("ACQ:NUMB:LIST ", sent, datatype="I")
        for points in (1, 12, 123, 1234):
            instrument.write(f"ACQ:POIN {points};:ACQ:NUMB:LIST?;:ACQ:POIN?")
            answer = instrument.read_raw()
            head = 2 + int(answer[1:2])
            assert answer.endswith(f";{points}\n".encode()), (values, points, answer[-12:])
            assert np.array_equal(np.frombuffer(answer[head : head + 4 * values], "<u4"), sent), (values, points)
            asked += 1
    assert instrument.query("SYST:ERR?") == NO_ERROR
    return asked


def records(bench: SimulatedBench, instrument: pyvisa.resources.MessageBasedResource) -> None:
    instrument.write("*RST;:ACQ:POIN 3;:ACQ:DWEL 1000;:ACQ:TRIG:SOUR BUS;:INIT")
    for _ in range(3):
        instrument.write("*TRG")
        bench.clock.sleep(0.002)
    assert instrument.query("ACQ:STAT?").startswith("DONE,3,")
    assert len(instrument.query_binary_values("ACQ:DATA? 0,3", datatype="B", container=bytes)) == 3 * (36 + 4 * 512)


def clears_and_silence(instrument: pyvisa.resources.MessageBasedResource) -> None:
    for _ in range(300):  # so that its bTag goes round
        try:
            instrument.read()
        except pyvisa.VisaIOError:
            pass
        else:
            raise AssertionError("an answer came to no question")
        assert instrument.query("SYST:ERR?") == '-420,"Query UNTERMINATED"'
        assert instrument.query("*IDN?") == "NLOS,TCSPC-488,SIM0001,1.0.0"


if __name__ == "__main__":
    packet = int(sys.argv[1])
    bench, instrument = opened(packet)
    count = answers_of_every_length(instrument, packet)
    records(bench, instrument)
    clears_and_silence(instrument)
    print(f"answers {count}")
