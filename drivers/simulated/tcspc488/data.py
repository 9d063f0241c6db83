"""Data blocks of a simulated `tcspc488`: slots into records, lists into blocks, and how a block can go wrong (U12)."""

import struct
from collections.abc import Sequence

from nlos.drivers.simulated.tcspc488.acquisition import Acquisition, Slot
from nlos.drivers.tcspc.tcspc488.records import RecordHead, encode_record


def answer_block(values: Sequence[int]) -> bytes:
    """A definite block of u32."""
    return encode_block(struct.pack(f"<{len(values)}I", *values))


def answer_records(slots: Sequence[Slot], acquisition: Acquisition, spoil: str = "") -> bytes:
    """A definite block of records; `spoil` names what is wrong with it."""
    wide, armed_s = acquisition.settings.wide, acquisition.armed_s
    records = [_record(slot, slot.number, armed_s, wide) for slot in slots]
    if spoil == "number":
        records[0] = _record(slots[0], slots[0].number + 1, armed_s, wide)
    elif spoil == "duplicate":
        records[-1] = records[0] if len(records) > 1 else _record(slots[0], slots[0].number - 1, armed_s, wide)
    elif spoil in ("crc", "magic"):
        at = 40 if spoil == "crc" else 0
        first = records[0]
        records[0] = first[:at] + bytes([first[at] ^ 0x40]) + first[at + 1 :]
    payload = b"".join(records)
    if spoil == "indefinite":
        return b"#0" + payload
    if spoil == "header":
        return b"#x" + encode_block(payload)[2:]
    if spoil == "length":
        return encode_block(payload[:-8])[:8] + payload
    return encode_block(payload)


def _record(slot: Slot, number: int, armed_s: float, wide: bool) -> bytes:
    seen = slot.exposure
    head = RecordHead(
        number & 0xFFFFFFFF, round((slot.gate.opened_s - armed_s) * 1e9), round(seen.live_s * 1e6),
        min(seen.total_count, 0xFFFFFFFF), min(seen.sync_count, 0xFFFFFFFF), slot.flags,
    )  # fmt: skip
    return encode_record(head, seen.counts, wide)


def encode_block(payload: bytes) -> bytes:
    """An IEEE 488.2 definite block: `#`, digits of the length, the length, the bytes."""
    digits = str(len(payload)).encode()
    return b"#%d%s%s" % (len(digits), digits, payload)
