"""T3 records decoded in a stream: photons and markers on one count of laser pulses, whatever the instrument.

Layouts from PicoQuant's file format documents and their demo readers; a 32-bit record is
    generic      special 1 | channel 6 | delay 15 | pulse 10     (HydraHarp, MultiHarp, TimeHarp 260, PicoHarp 330)
    PicoHarp 300 channel 4 | delay 12 | pulse 16                 (channel 15 is special)
where `pulse` wraps, and special records say how often it has wrapped, or which marker inputs saw an edge.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Records = npt.NDArray[np.uint32]
Pulses = npt.NDArray[np.int64]


@dataclass(frozen=True)
class T3Format:
    """Where the fields of a record are. `counts_wraps`: one overflow record may stand for several."""

    name: str
    pulse_bits: int
    delay_bits: int
    special_from: int
    """Records from this value on are special: the top bit, or channel 15."""
    first_channel: int
    counts_wraps: bool

    @property
    def wrap(self) -> int:
        """Laser pulses between two overflow records."""
        return 1 << self.pulse_bits

    def delays(self, photons: Records) -> Records:
        """Delay after the laser pulse in time bins, shape as given."""
        return photons >> np.uint32(self.pulse_bits) & np.uint32((1 << self.delay_bits) - 1)

    def channels(self, photons: Records) -> Records:
        """Detector channel, 0-based, shape as given."""
        return (photons >> np.uint32(self.pulse_bits + self.delay_bits)) - np.uint32(self.first_channel)


GENERIC = T3Format("generic T3", 10, 15, 1 << 31, 0, True)
HYDRAHARP_V1 = T3Format("HydraHarp T3 version 1", 10, 15, 1 << 31, 0, False)
PICOHARP_300 = T3Format("PicoHarp 300 T3", 16, 12, 15 << 28, 1, False)

FORMATS = {
    0x00010303: PICOHARP_300,
    0x00010304: HYDRAHARP_V1,
    0x01010304: GENERIC,
    0x00010305: GENERIC,
    0x00010306: GENERIC,
    0x00010307: GENERIC,
}
"""`TTResultFormat_TTTRRecType` of a PTU file -> layout."""


@dataclass(frozen=True)
class T3Events:
    """What one piece of the stream held. Pulses count from the start of the measurement."""

    format: T3Format
    photons: Records  # (n,) as recorded
    photon_pulses: Pulses  # (n,)
    marker_bits: npt.NDArray[np.uint8]  # (m,) bit 0 is marker 1
    marker_pulses: Pulses  # (m,)
    until_pulse: int
    """Everything before this pulse has been decoded, markers apart: they may come a little later than their time."""


class T3Decoder:
    """Takes the stream in pieces of any size and keeps what a piece leaves unfinished."""

    def __init__(self, layout: T3Format) -> None:
        self.format = layout
        self._base = 0
        self._last = 0
        self._rest = b""

    def feed(self, data: "bytes | bytearray | memoryview | npt.NDArray[np.uint32]") -> T3Events:
        """Decodes the next piece: bytes as they came, or whole records."""
        if isinstance(data, np.ndarray):
            records = data.astype("<u4", copy=False)
        else:
            whole = self._rest + bytes(data) if self._rest else data
            count = len(whole) // 4
            self._rest = bytes(whole[count * 4 :])
            records = np.frombuffer(whole, "<u4", count)
        return self._decode(records)

    def _decode(self, records: Records) -> T3Events:
        layout = self.format
        special = records >= np.uint32(layout.special_from)
        places = np.flatnonzero(special)
        codes = records[places]
        wraps, bits = self._read_specials(codes)
        # Pulse base after each special record, and how many photons follow it before the next one.
        bases = np.concatenate(([self._base], self._base + np.cumsum(wraps) * layout.wrap))
        following = np.diff(places, prepend=-1, append=len(records)) - 1
        photons = records[~special] if len(places) else records
        pulses = (photons & np.uint32(layout.wrap - 1)).astype(np.int64)
        pulses += np.repeat(bases, following)
        markers = np.flatnonzero(bits)
        marker_pulses = bases[1:][markers] + (codes[markers] & np.uint32(layout.wrap - 1))
        self._base = int(bases[-1])
        self._last = max(self._last, self._base, int(pulses[-1]) if len(pulses) else 0)
        return T3Events(layout, photons, pulses, bits[markers], marker_pulses, self._last)

    def _read_specials(self, codes: Records) -> tuple[Pulses, npt.NDArray[np.uint8]]:
        """How many wraps each special record stands for (0 for a marker), and its marker bits (0 for a wrap)."""
        layout = self.format
        count = (codes & np.uint32(layout.wrap - 1)).astype(np.int64)
        if layout.first_channel:
            bits: npt.NDArray[Any] = layout.delays(codes) & np.uint32(0xF)
            overflow = bits == 0
        else:
            channel = codes >> np.uint32(25) & np.uint32(0x3F)
            overflow = channel == 63
            bits = np.where(channel <= 15, channel, 0)
        wraps = np.where(overflow, np.maximum(count, 1) if layout.counts_wraps else 1, 0)
        return wraps.astype(np.int64), bits.astype(np.uint8)
