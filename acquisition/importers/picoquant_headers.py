"""Headers of PicoQuant's files from before PTU: PT3, HT3, T3R, PHD, HHD and THD, as byte layouts.

Layouts after the vendor's file format descriptions (PicoHarp 300 v2.0, HydraHarp 400 v1.0 and v2.0, TimeHarp 200
v2.0 to v6.0); little-endian, structures aligned to four bytes. Exposures are what a measurement took ("StopAfter"),
not what was asked for ("Tacq"), wherever it is stored.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from nlos.acquisition.errors import InvalidData

_DISPLAY_AND_SCRIPT = "16i 9f 4i 20s"  # eight display curves, three parameters, repetition, script name
_HYDRAHARP_HEAD = "6i d 2i I 7i"
_HYDRAHARP_BOARD = "16s 8s 2i 20i d Q 8i"
_PICOHARP_HEAD = "10i I 7i"
_PICOHARP_BOARD = "16s 8s 6i f 2i 24i"
_TIMEHARP_HEAD = "11i I 7i"
_TIMEHARP_CURVE = "10i 3f 9i f 2i"


@dataclass(frozen=True)
class RecordFile:
    """A file of time-tagged records: where they begin, how many there are, and the width of a delay bin."""

    instrument: str
    t3: bool
    records_at: int
    records: int
    bin_width_s: float
    acquisition_s: float
    """How long it took, or was meant to where that is not stored."""


@dataclass(frozen=True)
class Curve:
    """One stored histogram: where its counts lie, its axis, and the sum that its header states."""

    at: int
    bins: int
    bin_width_s: float
    acquisition_s: float
    total: int


class _Cursor:
    """Reads structures one after the other, and refuses to read past the end."""

    def __init__(self, name: str, data: bytes, at: int) -> None:
        self.name, self.data, self.at = name, data, at

    def take(self, layout: str) -> Sequence[float]:
        """The numbers of a structure; its texts come out as 0."""
        layout = "<" + layout
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise InvalidData(f"{self.name}: the file ends inside a header structure, at byte {len(self.data)}")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return [0.0 if isinstance(value, bytes) else value for value in values]

    def small(self, value: float) -> int:
        """A number of further items; thousands of them are a damaged header."""
        if not 0 <= value <= 1024:
            raise InvalidData(f"{self.name}: the header states {value:g} items where a few are expected")
        return int(value)


def instrument_and_version(name: str, data: bytes) -> tuple[str, str]:
    """The first two text fields: which instrument wrote the file, in which format version."""
    if len(data) < 328:
        raise InvalidData(f"{name}: {len(data)} bytes are too few for a PicoQuant header")
    fields = (data[:16], data[16:22])
    ident, version = (field.split(b"\0")[0].decode("ascii", "replace").strip() for field in fields)
    return ident, version


def is_histograms(name: str, data: bytes) -> bool:
    """Whether the header says that the file holds stored histograms, not records of single photons."""
    ident, _ = instrument_and_version(name, data)
    cursor = _Cursor(name, data, _timeharp_head_at(name, data) if ident == "TimeHarp 200" else 328)
    place = {"PicoHarp 300": 5, "HydraHarp": 3, "TimeHarp 200": 6}.get(ident, 0)
    return cursor.take(f"{place + 1}i")[place] == 0


def _timeharp_head_at(name: str, data: bytes) -> int:
    """Where the numbers begin: texts are longer from 6.0 on."""
    return 328 if instrument_and_version(name, data)[1] == "6.0" else 304


def _timeharp(name: str, data: bytes) -> tuple[_Cursor, Sequence[float], Sequence[float]]:
    """Head and board of a TimeHarp file, and what follows them."""
    at = _timeharp_head_at(name, data)
    cursor = _Cursor(name, data, at)
    head = cursor.take(_TIMEHARP_HEAD)
    cursor.take(_DISPLAY_AND_SCRIPT)
    return cursor, head, cursor.take("16s 8s 5i f" if at == 328 else "5i f")


def _took_s(took_ms: float, asked_ms: float) -> float:
    return 1e-3 * (took_ms if took_ms > 0 else asked_ms)


def picoharp_records(name: str, data: bytes) -> RecordFile:
    """Header of a .pt2 or .pt3 file, format 2.0."""
    cursor = _Cursor(name, data, 328)
    head = cursor.take(_PICOHARP_HEAD)
    cursor.take(_DISPLAY_AND_SCRIPT)
    board = cursor.take(_PICOHARP_BOARD)
    tagging = cursor.take("9i")
    cursor.take(f"{cursor.small(tagging[8])}i")
    lasted_s = _took_s(tagging[5], head[9])
    return RecordFile("PicoHarp 300", head[5] == 3, cursor.at, int(tagging[7]), board[8] * 1e-9, lasted_s)


def hydraharp_records(name: str, data: bytes) -> RecordFile:
    """Header of a .ht2 or .ht3 file, format 1.0 or 2.0."""
    cursor = _Cursor(name, data, 328)
    head = cursor.take(_HYDRAHARP_HEAD)
    cursor.take(_DISPLAY_AND_SCRIPT)
    board = cursor.take(_HYDRAHARP_BOARD)
    cursor.take(f"{5 * cursor.small(board[26])}i")
    tagging = cursor.take("4i Q")
    cursor.take(f"{cursor.small(tagging[3])}i")
    lasted_s = _took_s(tagging[1], head[8])
    return RecordFile("HydraHarp 400", head[3] == 3, cursor.at, int(tagging[4]), head[6] * 1e-12, lasted_s)


def timeharp_records(name: str, data: bytes) -> RecordFile:
    """Header of a .t3r file, format 5.0 or 6.0."""
    cursor, head, board = _timeharp(name, data)
    tagging = cursor.take("13i")
    cursor.take(f"{cursor.small(tagging[12])}i")
    lasted_s = _took_s(tagging[9], head[10])
    return RecordFile("TimeHarp 200", True, cursor.at, int(tagging[11]), board[-1] * 1e-9, lasted_s)


def picoharp_curves(name: str, data: bytes) -> list[Curve]:
    """Directory of the histograms in a .phd file, format 2.0."""
    cursor = _Cursor(name, data, 328)
    curves = cursor.small(cursor.take(_PICOHARP_HEAD)[0])
    cursor.take(_DISPLAY_AND_SCRIPT)
    cursor.take(_PICOHARP_BOARD)
    found = []
    for _ in range(curves):
        values = cursor.take("2i 16s 8s 11i 3f i f 7i q 2i 8i")
        lasted_s = _took_s(values[22], values[21])
        found.append(Curve(int(values[29]), int(values[20]), values[19] * 1e-9, lasted_s, int(values[27])))
    return found


def hydraharp_curves(name: str, data: bytes) -> list[Curve]:
    """Directory of the histograms in a .hhd file, format 1.0 or 2.0."""
    cursor = _Cursor(name, data, 328)
    curves = cursor.small(cursor.take(_HYDRAHARP_HEAD)[0])
    cursor.take(_DISPLAY_AND_SCRIPT)
    board = cursor.take(_HYDRAHARP_BOARD)
    cursor.take(f"{4 * cursor.small(board[26])}i")
    found = []
    for _ in range(curves):
        cursor.take("2i " + _HYDRAHARP_BOARD + "5i")
        values = cursor.take("3i d 4i 3f 3i q 2i")
        lasted_s = _took_s(values[6], values[5])
        found.append(Curve(int(values[16]), int(values[15]), values[3] * 1e-12, lasted_s, int(values[14])))
    return found


def timeharp_curves(name: str, data: bytes) -> list[Curve]:
    """Directory of the histograms in a .thd file, format 2.0 to 6.0: each stands behind its own header."""
    cursor, head, _ = _timeharp(name, data)
    bins, found = int(head[0]), []
    for _ in range(cursor.small(head[1])):
        values = cursor.take(_TIMEHARP_CURVE)
        found.append(Curve(cursor.at, bins, values[22] * 1e-9, _took_s(values[16], values[15]), int(values[21])))
        cursor.at += 4 * max(0, bins)
    return found
