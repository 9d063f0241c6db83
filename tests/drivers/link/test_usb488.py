"""Whole messages over USBTMC, whatever the cable and the device do to them (faults U1 to U11, U17, U19)."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from nlos.drivers.errors import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, DeviceTimeout, ProtocolError
from nlos.drivers.link.usb488 import Usb488
from nlos.drivers.link.usb_errors import PipeHalted
from nlos.drivers.link.usb_search import find_usb
from nlos.drivers.link.usbtmc import UsbtmcInterface
from nlos.drivers.simulated.faults import Fault, FaultPlan
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.simulated.usb.descriptors import UsbDescription

ALWAYS = 1_000_000


def fault(name: str, times: int = 1, skip: int = 0, **parameters: Any) -> Fault:
    return Fault(name=name, times=times, skip=skip, parameters=parameters)


def check_usable(rig: Any, link: Usb488 | None = None) -> None:
    for count in (1, 37, 500):
        assert (link or rig.link).ask(b"%d" % count, 1.0) == rig.said(count)


@pytest.mark.parametrize("packet_bytes", [64, 512, 1024])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 51, 52, 53, 499, 500, 501, 1011, 1012, 1013, 4096, 70_000])
def test_every_length_arrives_whole_at_every_packet_size(cable: Callable, packet_bytes: int, count: int) -> None:
    rig = cable(packet_bytes=packet_bytes)
    assert rig.link.ask(b"%d" % count, 1.0) == rig.said(count)
    assert rig.link.ask(b"%d" % count, 1.0, expected=count) == rig.said(count)


@pytest.mark.parametrize("size", [1, 7, 512])
def test_an_answer_chopped_into_small_transfers_is_put_together(cable: Callable, size: int) -> None:
    rig = cable(fault("U6", ALWAYS, what="split", size=size))
    assert rig.link.ask(b"1500", 1.0) == rig.said(1500)


@pytest.mark.parametrize("count", [500, 1012, 116])
def test_a_missing_zero_length_packet_costs_a_moment_not_the_answer(cable: Callable, count: int) -> None:
    rig = cable(fault("U7", ALWAYS))
    start_s = rig.clock.now()
    assert rig.link.ask(b"%d" % count, 1.0) == rig.said(count)
    assert rig.clock.now() - start_s <= 0.11
    check_usable(rig)


class LateEmptyPackets(SimulatedUsb):
    """Whose zero-length packets come with the next transfer."""

    left = 0

    def bulk_read(self, *given: Any) -> int:
        self.left -= 1
        return 0 if self.left >= 0 else super().bulk_read(*given)


def test_a_zero_length_packet_of_an_earlier_transfer_is_no_answer(cable: Callable) -> None:
    """Of a stream that is told once the answer could not be asked for again."""
    rig = cable()
    rig.backend.__class__, rig.backend.left = LateEmptyPackets, 1
    assert rig.link.ask(b"500", 1.0) == rig.said(500)
    assert rig.parrot.messages == [b"500"]
    rig.backend.left = 2
    with pytest.raises(ProtocolError, match="the first packet holds 0 bytes"):
        rig.link.ask(b"37", 1.0)
    check_usable(rig)


@pytest.mark.parametrize("pad", [0, 1, 2, 3])
def test_padding_is_trimmed_whatever_it_holds(cable: Callable, pad: int) -> None:
    rig = cable(fault("U8", ALWAYS, bytes=pad))
    for count in (497, 498, 499, 500, 501):
        assert rig.link.ask(b"%d" % count, 1.0) == rig.said(count)


def test_messages_out_are_always_a_multiple_of_four(cable: Callable) -> None:
    rig = cable(packet_bytes=64)
    for length in range(1, 70):
        rig.link.write(b"x" * length + b"!", 1.0)
    assert all(len(data) % 4 == 0 for way, data in rig.wire if way == ">")
    assert rig.parrot.messages == [b"x" * length + b"!" for length in range(1, 70)]


def test_the_wire_log_holds_control_requests_as_they_travel(cable: Callable) -> None:
    rig = cable(packet_bytes=512)
    rig.wire.clear()
    rig.link.clear()
    assert rig.wire == [
        (">", bytes([0xA1, 5, 0, 0, 0, 0, 1, 0])),
        ("<", b"\x01"),
        (">", bytes([0xA1, 6, 0, 0, 0, 0, 2, 0])),
        ("<", b"\x01\x00"),
        (">", bytes([0x02, 1, 0, 0, 0x01, 0, 0, 0])),
    ]


def test_trigger_status_byte_and_clear(cable: Callable) -> None:
    rig = cable()
    rig.link.trigger(1.0)
    assert rig.parrot.triggers == 1
    for _ in range(130):
        assert rig.link.status_byte(1.0) == 0x54
    rig.link.clear()
    check_usable(rig)


@pytest.mark.parametrize("before", [True, False])
def test_a_service_request_beside_a_status_byte_is_not_lost(cable: Callable, before: bool) -> None:
    rig = cable()
    if before:  # the interrupt pipe is busy with it
        rig.parrot.service_requests = 1
    else:  # it comes after the question, before the answer is read

        def arrive(device: str, way: str, data: bytes) -> None:
            if way == "<" and len(data) == 3:
                rig.backend.device("P1").notifications.appendleft(b"\x81\x54")

        rig.link._pipes._log = arrive
    assert rig.link.status_byte(1.0) == 0x54
    start_s = rig.clock.now()
    assert rig.link.wait_service_request(1.0)
    assert rig.clock.now() == start_s
    assert not rig.link.wait_service_request(0.1)
    assert rig.clock.now() == pytest.approx(start_s + 0.1)


def test_an_interrupt_pipe_that_stalls_is_cleared_and_one_that_stays_so_is_told(cable: Callable) -> None:
    """Nothing else would clear it: neither opening it anew nor the way back from a failed exchange."""
    rig = cable()
    rig.parrot.faults.add(fault("U3", place="interrupt"))
    assert rig.link.status_byte(1.0) == 0x54
    rig.parrot.faults.add(fault("U3", place="interrupt"))
    rig.parrot.service_requests = 1
    assert rig.link.wait_service_request(1.0)
    rig.parrot.faults.add(fault("U3", ALWAYS, place="interrupt"))
    with pytest.raises(PipeHalted, match="service request"):
        rig.link.wait_service_request(1.0)


def test_an_interrupt_pipe_that_stays_busy_is_given_up_in_time(cable: Callable) -> None:
    rig = cable(latency_s=0.001)
    rig.parrot.service_requests = ALWAYS
    start_s = rig.clock.now()
    with pytest.raises(DeviceTimeout, match="status byte"):
        rig.link.status_byte(0.5)
    assert rig.clock.now() - start_s == pytest.approx(0.5, abs=0.01)
    rig.parrot.service_requests = 0
    assert rig.link.wait_service_request(0.0)
    check_usable(rig)


FAULTS = {
    "U1": (fault("U1"), DeviceTimeout),
    "U2": (fault("U2", packets=1), DeviceTimeout),
    "U3 in": (fault("U3", place="in"), PipeHalted),
    "U3 out": (fault("U3", place="out"), PipeHalted),
    "U5 tag": (fault("U5", field="tag"), ProtocolError),
    "U5 inverse": (fault("U5", field="inverse"), ProtocolError),
    "U5 kind": (fault("U5", field="kind"), ProtocolError),
    "U5 reserved": (fault("U5", field="reserved"), ProtocolError),
    "U6 too large": (fault("U6", what="too_large"), ProtocolError),
    "U6 cut": (fault("U6", what="cut"), ProtocolError),
    "U6 early end": (fault("U6", what="early_end"), ProtocolError),
    "U8 too much": (fault("U8", bytes=9), ProtocolError),
    "U10": (fault("U10"), ProtocolError),
}


def break_once(cable: Callable, first: Fault) -> Any:
    """A link on which the fault strikes the next exchange: opening is not disturbed."""
    rig = cable()
    rig.parrot.faults.add(first)
    return rig


@pytest.mark.parametrize("name", FAULTS)
def test_a_broken_answer_is_a_named_error_and_the_next_one_is_right(cable: Callable, name: str) -> None:
    first, error = FAULTS[name]
    rig = break_once(cable, first)
    start_s = rig.clock.now()
    with pytest.raises(error):
        rig.link.ask(b"2000", 1.0)
    assert rig.clock.now() - start_s <= 2.0
    check_usable(rig)


@pytest.mark.parametrize("count", range(1, 13))
@pytest.mark.parametrize("pad", range(4))
def test_padding_is_never_taken_for_the_end_of_an_answer(cable: Callable, count: int, pad: int) -> None:
    rig = break_once(cable, fault("U6", what="cut"))
    rig.parrot.faults.add(fault("U8", bytes=pad))
    with pytest.raises(DeviceError):
        rig.link.ask(b"%d" % count, 1.0)
    check_usable(rig)


def test_a_control_stall_during_recovery_ends_in_a_reset_and_a_clean_link(cable: Callable) -> None:
    rig = break_once(cable, fault("U1"))
    rig.parrot.faults.add(fault("U3", place="control"))
    with pytest.raises(DeviceTimeout):
        rig.link.ask(b"10", 0.5)
    check_usable(rig)


@pytest.mark.parametrize("replies", [1, 3, 10])
def test_pending_is_waited_for(cable: Callable, replies: int) -> None:
    rig = break_once(cable, fault("U1"))
    rig.parrot.faults.add(fault("U4", replies=replies))
    with pytest.raises(DeviceTimeout):
        rig.link.ask(b"10", 0.5)
    check_usable(rig)


def test_pending_for_ever_ends_in_device_lost_within_its_deadlines(cable: Callable) -> None:
    rig = break_once(cable, fault("U1"))
    rig.parrot.faults.add(fault("U4", ALWAYS, replies=ALWAYS))
    start_s = rig.clock.now()
    with pytest.raises(DeviceLost):
        rig.link.ask(b"10", 0.5)
    assert rig.clock.now() - start_s < 5.0


def test_a_slow_device_is_waited_for(cable: Callable) -> None:
    rig = cable(fault("U19", ALWAYS, delay_s=0.005), latency_s=0.001)
    for _ in range(20):
        assert rig.link.ask(b"2048", 1.0) == rig.said(2048)
    assert rig.clock.now() >= 20 * 0.005


def test_an_answer_later_than_its_deadline_is_never_taken_for_the_next(cable: Callable) -> None:
    rig = break_once(cable, fault("U19", delay_s=1.5))
    with pytest.raises(DeviceTimeout):
        rig.link.ask(b"300", 1.0)
    assert rig.link.ask(b"5", 1.0) == rig.said(5)
    rig.clock.sleep(1.0)
    assert rig.link.ask(b"6", 1.0) == rig.said(6)


@pytest.mark.parametrize("place", ["read", "write", "control"])
@pytest.mark.parametrize("error", ["gone", "io"])
def test_a_pulled_cable_is_device_lost_and_closing_still_works(cable: Callable, place: str, error: str) -> None:
    rig = break_once(cable, fault("U11", place=place, error=error))
    ask = rig.link.clear if place == "control" else lambda: rig.link.ask(b"10", 0.5)
    with pytest.raises(DeviceLost, match="cable"):
        ask()
    with pytest.raises(DeviceLost):
        rig.link.ask(b"10", 0.5)
    rig.link.close()
    rig.link.close()
    with pytest.raises(DeviceNotFound, match="plugged in"):
        find_usb("parrot", 0x1209, 1, None, rig.backend)
    rig.backend.replug("P1")
    found = find_usb("parrot", 0x1209, 1, "P1", rig.backend)
    check_usable(rig, Usb488(UsbtmcInterface("parrot", found), rig.clock))


def test_a_device_is_found_by_serial_number_or_the_error_names_those_there_are(cable: Callable) -> None:
    rig = cable()
    with pytest.raises(DeviceNotFound, match=r"P2 .*found: P1"):
        find_usb("parrot", 0x1209, 1, "P2", rig.backend)


def test_of_two_devices_with_one_serial_number_neither_is_taken(cable: Callable) -> None:
    rig = cable()
    both = SimulatedUsb([rig.parrot, replace(rig.parrot)], rig.clock)
    with pytest.raises(DeviceNotFound, match=r"2 USB devices 1209:0001 with serial number P1\. Unplug"):
        find_usb("parrot", 0x1209, 1, "P1", both)


def test_another_device_whose_serial_number_cannot_be_read_is_not_in_the_way(cable: Callable) -> None:
    rig = cable()
    another = UsbDescription(0x1209, 1, "NLOS", "parrot", "P0", 512)
    hidden = replace(rig.parrot, usb=another, faults=FaultPlan([fault("U17", ALWAYS, what="access")]))
    found = find_usb("parrot", 0x1209, 1, "P1", SimulatedUsb([hidden, rig.parrot], rig.clock))
    assert found.serial_number == "P1"
    with pytest.raises(DeviceBusy, match="udev"):
        find_usb("parrot", 0x1209, 1, "P2", SimulatedUsb([hidden, rig.parrot], rig.clock))


@pytest.mark.parametrize(("what", "words"), [("busy", "another program"), ("access", "udev")])
def test_a_device_that_may_not_be_opened_says_what_to_do(cable: Callable, what: str, words: str) -> None:
    rig = cable()
    rig.link.close()
    rig.parrot.faults.add(fault("U17", what=what))
    with pytest.raises(DeviceBusy, match=words):
        UsbtmcInterface("parrot", find_usb("parrot", 0x1209, 1, None, rig.backend))


def test_a_kernel_driver_is_detached_and_attached_again(cable: Callable) -> None:
    rig = cable()
    rig.link.close()
    rig.parrot.faults.add(fault("U17", what="kernel_driver"))
    pipes = UsbtmcInterface("parrot", find_usb("parrot", 0x1209, 1, None, rig.backend))
    check_usable(rig, Usb488(pipes, rig.clock))
    port = rig.backend.enumerate_devices()[0]
    assert not port.kernel_driver
    pipes.close()
    assert port.kernel_driver


def test_an_urgent_message_goes_past_an_answer_under_way(cable: Callable) -> None:
    rig = cable()
    rig.link._busy = True  # as a signal handler finds it in the middle of an exchange
    rig.link.urgent(b"shut!", 1.0)
    assert rig.parrot.messages == [b"shut!"]
    rig.link._busy = False
    check_usable(rig)


def test_an_urgent_message_does_not_wait_for_a_thread_that_holds_the_link(cable: Callable) -> None:
    rig = cable()
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with rig.link.lock:
            held.set()
            done.wait(240)

    other = threading.Thread(target=hold)
    other.start()
    held.wait(30)
    rig.link.urgent(b"shut!", 1.0)
    assert rig.parrot.messages == [b"shut!"]
    assert not done.is_set()
    done.set()
    other.join()
    check_usable(rig)


@pytest.mark.parametrize("way", ["<", ">"])
@pytest.mark.parametrize("at", [0, 1])
def test_an_exchange_cut_short_by_an_interrupt_leaves_no_stale_answer(cable: Callable, way: str, at: int) -> None:
    rig = cable()
    left = [at]

    def interrupt(device: str, direction: str, data: bytes) -> None:
        if direction == way:
            left[0] -= 1
            if left[0] == -1:
                raise KeyboardInterrupt

    rig.link._pipes._log = interrupt
    with pytest.raises(KeyboardInterrupt):
        [rig.link.ask(b"700", 1.0) for _ in range(3)]
    rig.link._pipes._log = None
    rig.link.urgent(b"shut!", 1.0)
    assert rig.parrot.messages[-1] == b"shut!"
    check_usable(rig)
    assert -410 not in rig.parrot.errors


ANY_FAULT = st.one_of(
    st.sampled_from([each for each, _ in FAULTS.values()]),
    st.builds(lambda size, times: fault("U6", times, what="split", size=size), st.integers(1, 600), st.integers(1, 9)),
    st.builds(lambda count: fault("U7", count), st.integers(1, 5)),
    st.builds(lambda pad: fault("U8", bytes=pad), st.integers(0, 3)),
    st.builds(lambda delay: fault("U19", delay_s=delay), st.floats(0, 3)),
    st.builds(lambda place: fault("U11", place=place), st.sampled_from(["read", "write", "control"])),
)


@example(faults=[fault("U6", what="cut"), fault("U8", bytes=1)], counts=[1], packet_bytes=64)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.builds(lambda f, skip: f.model_copy(update={"skip": skip}), ANY_FAULT, st.integers(0, 6)), max_size=4),
    st.lists(st.integers(1, 3000), min_size=1, max_size=6),
    st.sampled_from([64, 512, 1024]),
)
def test_the_answer_is_right_or_the_error_has_a_name(
    cable: Callable, faults: list[Fault], counts: list[int], packet_bytes: int
) -> None:
    rig = None
    try:
        rig = cable(*faults, packet_bytes=packet_bytes)
    except DeviceError:
        return
    for count in counts:
        start_s = rig.clock.now()
        try:
            assert rig.link.ask(b"%d" % count, 1.0) == rig.said(count)
        except DeviceLost:
            return
        except DeviceError:
            pass
        assert rig.clock.now() - start_s < 6.0
