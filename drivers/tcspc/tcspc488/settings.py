"""What a bench file says about a `tcspc488`, and the commands that say it to the instrument."""

from typing import Literal

from pydantic import Field

from nlos.configs.settings import Settings


class SyncInput(Settings):
    """The laser's synchronisation input."""

    level_mv: int = Field(default=-100, ge=-1200, le=1200)
    edge: Literal["rising", "falling"] = "falling"
    divider: Literal[1, 2, 4, 8, 16] = 1
    delay_ps: int = Field(default=0, ge=-99999, le=99999)


class DetectorInput(Settings):
    """The single-photon detector's input."""

    level_mv: int = Field(default=-100, ge=-1200, le=1200)
    edge: Literal["rising", "falling"] = "falling"
    delay_ps: int = Field(default=0, ge=-99999, le=99999)
    dead_time_ps: int = Field(default=800, ge=800, le=160000)


class OverCount(Settings):
    """The instrument closes the shutter when the detector's rate stays above `rate_hz` for `time_ms`."""

    rate_hz: int = Field(default=5_000_000, ge=0, le=1_000_000_000)
    time_ms: int = Field(default=10, ge=1, le=1000)


class Tcspc488Settings(Settings):
    """`usb`: "simulated", "auto" (the only one plugged in) or a serial number."""

    model: Literal["tcspc488"]
    usb: str = "auto"
    vendor_id: int = Field(default=0x1209, ge=0, le=0xFFFF)
    product_id: int = Field(default=0x0001, ge=0, le=0xFFFF)
    mode: Literal["histogram", "t3"] = "histogram"
    """Histograms made by the instrument, or by this computer from a record of every photon."""
    marker_disorder_us: float = Field(default=50.0, ge=0, le=10_000)
    """T3 mode: how much later than photons of the same time a marker may stand in the record stream."""
    timeout_s: float = Field(default=1.0, ge=0.05, le=60.0)
    sync: SyncInput = SyncInput()
    detector: DetectorInput = DetectorInput()
    over_count: OverCount = OverCount()
    counts: Literal["u16", "u32"] = "u32"
    markers: bool = False
    """Whether the mirror controller's marker outputs 1 to 3 are wired to the counter's marker inputs."""

    @property
    def simulated(self) -> bool:
        return self.usb == "simulated"


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
