"""A simulated serial device behind a pseudo-terminal, so that any other program can open it. POSIX only.

`python -m nlos.drivers.simulated.serial.pty triggerscope` prints the port to open and serves it until Ctrl-C.
Bench time follows the computer's clock here: the other program has no other.
"""

import contextlib
import os
import select
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np

from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.serial.cable import SerialCable, SerialFirmware
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable

_LOOK_S = 0.01  # how often a closed port is looked at
_SETTLED_S = 0.2  # a host that opens a port empties it first; what the device says must come after
_POLL_S = 0.5


@contextlib.contextmanager
def served_on_pty(firmware: SerialFirmware, bench: SimulatedBench, latency_s: float = 0.0) -> Iterator[str]:
    """The path of a pseudo-terminal at which `firmware` answers, from a thread of its own, until the block is left:
    then the port vanishes as if it was unplugged."""
    import tty

    controller, port = os.openpty()
    woken, wake = os.pipe()
    tty.setraw(port)
    path = os.ttyname(port)
    os.close(port)
    cable = SerialCable("pty", firmware, bench, latency_s)
    thread = threading.Thread(target=_serve, args=(cable, controller, woken), daemon=True)
    thread.start()
    try:
        yield path
    finally:
        os.write(wake, b"x")  # nobody may be reading the terminal as it is closed, or it lives on
        thread.join()
        for end in (controller, woken, wake):
            os.close(end)


def _serve(cable: SerialCable, controller: int, woken: int) -> None:
    began_s = time.monotonic() - cable.clock.now()
    poller = select.poll()
    poller.register(controller, select.POLLIN)
    poller.register(woken, select.POLLIN)
    patience_s = 0.0
    while True:
        events = dict(poller.poll(patience_s * 1e3))
        cable.clock.advance_to(time.monotonic() - began_s)
        if woken in events:
            return
        if events.get(controller, 0) & select.POLLHUP:  # no host
            if cable.held:
                cable.close()
            patience_s = 0.0
            time.sleep(_LOOK_S)
            continue
        if not cable.held:
            time.sleep(_SETTLED_S)
            cable.open()
        if controller in events:
            cable.send(os.read(controller, 4096))
        if waiting := cable.arrived():
            os.write(controller, cable.take(waiting))
        event_s = cable.next_event_s()
        patience_s = _POLL_S if event_s is None else max(0.0, event_s - cable.clock.now())
        if not cable.held:
            patience_s = _LOOK_S


def main() -> None:
    """Serves the model named on the command line in the dark: its mirror moves, and no photon is counted."""
    served = {name: model for name, model in MIRRORS.items() if model.settings.cable == "serial"}
    if len(sys.argv) != 2 or sys.argv[1] not in served:
        sys.exit(f"usage: python -m nlos.drivers.simulated.serial.pty {'|'.join(sorted(served))}")
    model = served[sys.argv[1]]
    bench = SimulatedBench(lambda gate, beam, lit: Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False))
    settings = model.settings.model_validate({"model": model.name, "port": "sim://pty"})
    firmware = model.firmware(settings, SimulatedTable(bench, SimulationSettings(), 10e6))
    with served_on_pty(firmware, bench, 0.001) as path, contextlib.suppress(KeyboardInterrupt):
        print(path, flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
