"""The USBTMC recovery ladder: from an aborted transfer to a device clear. Every loop carries a deadline.

Sources: USBTMC 1.0 sections 3.1.1 and 4.2.1; the order of steps follows the Linux usbtmc driver.
"""

import array
from collections.abc import Callable
from functools import partial

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceLost, DeviceTimeout
from nlos.drivers.link.usb_errors import Overflow, PipeHalted
from nlos.drivers.link.usbtmc import UsbtmcInterface
from nlos.drivers.link.usbtmc_headers import (
    CHECK_ABORT_BULK_IN_STATUS,
    CHECK_ABORT_BULK_OUT_STATUS,
    CHECK_CLEAR_STATUS,
    INITIATE_ABORT_BULK_IN,
    INITIATE_ABORT_BULK_OUT,
    INITIATE_CLEAR,
    STATUS_PENDING,
    STATUS_SUCCESS,
    STATUS_TRANSFER_NOT_IN_PROGRESS,
)

STEP_S = 0.3
"""How long one transfer of the ladder may take."""
POLL_S = 0.05
"""Pause between two looks at a pending request (USBTMC asks for at least 50 ms)."""
MOST_READS = 100


class RecoveryFailed(DeviceTimeout):
    """The device did not come back to a known state in time; the next step of the ladder is due."""


def abort_bulk_in(pipes: UsbtmcInterface, clock: Clock, tag: int, earlier_tag: int, deadline_s: float) -> None:
    """Ends the response transfer of request `tag`, and throws away what it still held."""
    for candidate in (tag, earlier_tag):
        status = pipes.control(INITIATE_ABORT_BULK_IN, candidate, 2, STEP_S, pipe="in")[:1]
        if status != bytes([STATUS_TRANSFER_NOT_IN_PROGRESS]):
            break
    if status != bytes([STATUS_SUCCESS]):
        return  # nothing is in progress
    drain(pipes, clock, deadline_s)
    asked = partial(pipes.control, CHECK_ABORT_BULK_IN_STATUS, 0, 8, STEP_S, pipe="in")
    _drain_while_pending(pipes, clock, deadline_s, asked, "aborting a response")


def abort_bulk_out(pipes: UsbtmcInterface, clock: Clock, tag: int, deadline_s: float) -> None:
    """Ends the message transfer `tag` that the device stopped taking."""
    status = pipes.control(INITIATE_ABORT_BULK_OUT, tag, 2, STEP_S, pipe="out")[:1]
    if status != bytes([STATUS_SUCCESS]):
        return
    while pipes.control(CHECK_ABORT_BULK_OUT_STATUS, 0, 8, STEP_S, pipe="out")[:1] == bytes([STATUS_PENDING]):
        _still_time(pipes, clock, deadline_s, "aborting a message")
        clock.sleep(POLL_S)
    pipes.clear_halt("out")


def clear(pipes: UsbtmcInterface, clock: Clock, deadline_s: float) -> None:
    """Device clear: both buffers of the device empty, its parser at the start of a message.

    Settings and a running acquisition are left alone (IEEE 488.2 section 5.8).
    """
    status = pipes.control(INITIATE_CLEAR, 0, 1, STEP_S)
    if status[:1] != bytes([STATUS_SUCCESS]):
        raise RecoveryFailed(pipes.device, f"it refused a device clear (status {status.hex() or 'missing'}).")
    asked = partial(pipes.control, CHECK_CLEAR_STATUS, 0, 2, STEP_S)
    _drain_while_pending(pipes, clock, deadline_s, asked, "clearing its buffers")
    pipes.clear_halt("out")


def _drain_while_pending(
    pipes: UsbtmcInterface, clock: Clock, deadline_s: float, asked: Callable[[], bytes], what: str
) -> None:
    """Until the device has done what it was told to: its status says whether it holds bytes that are to be read."""
    while (reply := asked())[:1] == bytes([STATUS_PENDING]):
        _still_time(pipes, clock, deadline_s, what)
        if len(reply) > 1 and reply[1] & 1:
            drain(pipes, clock, deadline_s)
        else:
            clock.sleep(POLL_S)


def drain(pipes: UsbtmcInterface, clock: Clock, deadline_s: float) -> None:
    """Reads Bulk-IN until a short packet or silence."""
    buffer = array.array("B", bytes(8 * pipes.packet_bytes))
    for _ in range(MOST_READS):
        try:
            count = pipes.read_into(buffer, STEP_S)
        except DeviceTimeout:
            return
        except Overflow:
            continue
        except PipeHalted:
            pipes.clear_halt("in")
            return
        if count < len(buffer):
            return
        _still_time(pipes, clock, deadline_s, "emptying its answer")
    raise RecoveryFailed(pipes.device, f"it keeps sending ({MOST_READS} reads of {len(buffer)} bytes).")


def recover(pipes: UsbtmcInterface, clock: Clock, tag: int, earlier_tag: int, timeout_s: float) -> None:
    """Brings both ends back to the start of a message after any failure; at most `timeout_s`.

    Raises `DeviceLost` when not even a port reset helps.
    """
    deadline_s = clock.now() + timeout_s
    try:
        try:
            abort_bulk_in(pipes, clock, tag, earlier_tag, deadline_s)
        except PipeHalted:
            pipes.clear_halt("in")
        _clear_halts(pipes)
        clear(pipes, clock, deadline_s)
    except (DeviceTimeout, PipeHalted):
        try:
            pipes.reset()
            clear(pipes, clock, clock.now() + timeout_s)
        except (DeviceTimeout, PipeHalted) as error:
            raise DeviceLost(
                pipes.device, "it does not recover, even after a port reset.", "Switch it off and on."
            ) from error


def _clear_halts(pipes: UsbtmcInterface) -> None:
    for pipe in ("in", "out"):
        pipes.clear_halt(pipe)


def _still_time(pipes: UsbtmcInterface, clock: Clock, deadline_s: float, doing: str) -> None:
    if clock.now() >= deadline_s:
        raise RecoveryFailed(pipes.device, f"{doing} took too long.")
