"""What a bench file says about a `tcspc488`, and the commands that say it to the instrument."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.tcspc.block import CounterBlock, Pulse
from nlos.drivers.udev import usb_rule


class SyncInput(Settings):
    """The laser's synchronisation input."""

    level_mv: int = Field(default=-100, ge=-1200, le=1200)
    """Voltage that a pulse has to cross."""
    edge: Literal["rising", "falling"] = "falling"
    """On the way up or down."""
    divider: Literal[1, 2, 4, 8, 16] = 1
    """For a laser faster than the sync input: only every N-th pulse is timed, the instrument reckons those between.
    Times are after the last pulse, and rates and numbers of pulses are the laser's, as without it."""
    delay_ps: int = Field(default=0, ge=-99999, le=99999)
    """Added to this input's times, as a cable would."""


class DetectorInput(Settings):
    """The single-photon detector's input."""

    level_mv: int = Field(default=-100, ge=-1200, le=1200)
    """Voltage that a pulse has to cross."""
    edge: Literal["rising", "falling"] = "falling"
    """On the way up or down."""
    delay_ps: int = Field(default=0, ge=-99999, le=99999)
    """Added to this input's times, as a cable would."""
    dead_time_ps: int = Field(default=800, ge=800, le=160000)
    """How long the input is blind after a pulse."""


class OverCount(Settings):
    """The instrument closes the shutter when the detector's rate stays above `rate_hz` for `time_ms`."""

    rate_hz: int = Field(default=5_000_000, ge=0, le=1_000_000_000)
    """Detections per second; 0: never."""
    time_ms: int = Field(default=10, ge=1, le=1000)
    """How long the rate may be exceeded."""


class Tcspc488Settings(CounterBlock):
    """The counter block of a bench file."""

    cable: ClassVar = "usb"
    incidental: ClassVar[frozenset[str]] = CounterBlock.incidental | {
        "vendor_id", "product_id", "mode", "marker_disorder_us", "over_count", "counts", "markers", "mirror_steps",
    }  # fmt: skip
    listed_point_s: ClassVar[float] = 0.15e-3
    """Markers may come out of order, and the instrument's clock has to have gone round once."""

    model: Literal["tcspc488"]
    usb: str = "auto"
    """Serial number, "auto" (the only one plugged in), or "simulated"."""
    vendor_id: int = Field(default=0x1209, ge=0, le=0xFFFF)
    """USB vendor id."""
    product_id: int = Field(default=0x0001, ge=0, le=0xFFFF)
    """USB product id."""
    mode: Literal["histogram", "t3"] = "histogram"
    """Histograms made by the instrument, or by this computer from a record of every photon."""
    marker_disorder_us: float = Field(default=50.0, ge=0, le=10_000)
    """T3 mode: how much later than photons of the same time a marker may appear in the record stream."""
    timeout_s: float = Field(default=1.0, ge=0.05, le=60.0)
    """How long an answer may take."""
    sync: SyncInput = SyncInput()
    """The laser's synchronisation input."""
    detector: DetectorInput = DetectorInput()
    """The single-photon detector's input."""
    over_count: OverCount = OverCount()
    """When the instrument shuts the light off by itself."""
    counts: Literal["u16", "u32"] = "u32"
    """Width of a histogram bin on the way to the computer."""
    markers: bool = False
    """Whether the mirror controller's marker outputs 1 to 3 are wired to the counter's marker inputs."""
    mirror_steps: bool = False
    """Whether the fourth mark (one edge per point) of a mirror with a clock of its own is wired to the trigger in."""

    @classmethod
    def pulse_keys(cls, pulse: Pulse, device: str = "") -> Mapping[str, object] | None:
        """Levels of the instrument profile, -100 mV falling for NIM; TTL pulses come through an attenuator, for levels
        end at 1.2 V."""
        return {"level_mv": -100, "edge": "falling"} if pulse == "nim" else {"level_mv": 300, "edge": "rising"}

    @property
    def udev_rule(self) -> str:
        """By the ids in the bench file."""
        return usb_rule(self.vendor_id, self.product_id)


def input_commands(settings: Tcspc488Settings) -> dict[str, str]:
    """Header and value of every setting that stays the same from scan to scan."""
    edges = {"rising": "POS", "falling": "NEG"}
    return {
        "INP:SYNC:LEV": str(settings.sync.level_mv),
        "INP:SYNC:EDGE": edges[settings.sync.edge],
        "INP:SYNC:DIV": str(settings.sync.divider),
        "INP:SYNC:DEL": str(settings.sync.delay_ps),
        "INP:DET:LEV": str(settings.detector.level_mv),
        "INP:DET:EDGE": edges[settings.detector.edge],
        "INP:DET:DEL": str(settings.detector.delay_ps),
        "INP:DET:DTIM": str(settings.detector.dead_time_ps),
        "PROT:RATE": str(settings.over_count.rate_hz),
        "PROT:TIME": str(settings.over_count.time_ms),
        "HIST:FORM": settings.counts.upper(),
        "*SRE": "136",  # service request on a trip or fault (8) and on completion (128)
    }
