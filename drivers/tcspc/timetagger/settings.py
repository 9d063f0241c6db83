"""What a bench file says of a Swabian Time Tagger."""

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.tcspc.block import CounterBlock, Pulse

Channel = int
"""Number on the front panel, negative for falling edges, as the vendor counts."""


class TimeTaggerInput(Settings):
    """Sync or detector input."""

    channel: Channel = Field(ge=-18, le=18)
    """Number on the front panel; negative for the falling edge."""
    level_mv: int = Field(default=500, ge=-2500, le=2500)
    """Voltage that a pulse has to cross."""
    delay_ps: int = Field(default=0, ge=-99_999, le=99_999)
    """Added to this input's times, as a cable would; a Time Tagger 20 cannot."""


class TimeTaggerSettings(CounterBlock):
    """The counter block of a bench file."""

    cable: ClassVar = "library"
    incidental: ClassVar[frozenset[str]] = CounterBlock.incidental | {
        "mode", "markers", "marker_level_mv", "mirror_steps", "pixel_clock"}  # fmt: skip
    clock_output: ClassVar[str] = "TTL"
    usual_pulse: ClassVar[Pulse] = "ttl"
    listing_begins_s: ClassVar[float] = 0.1
    """The laser's rate is measured first."""
    listing_ends_s: ClassVar[float] = 0.12
    marker_input_most_v: ClassVar[float] = 5.0

    model: Literal["timetagger"]
    library: str = "vendor"
    """The installed Python package Swabian-TimeTagger ("vendor"), or "simulated"."""
    serial: str = "auto"
    """Serial number of the instrument, or "auto" for the only one that answers."""
    mode: Literal["histogram", "list"] = "histogram"
    """Histograms made by the vendor's library, or by this program from a tag of every photon."""
    sync: TimeTaggerInput = TimeTaggerInput(channel=1)
    """The laser's synchronisation input."""
    detector: TimeTaggerInput = TimeTaggerInput(channel=2)
    """The single-photon detector's input."""
    markers: tuple[Channel, Channel, Channel] = (3, 4, 5)
    """Inputs to which the mirror controller's marker outputs 1, 2 and 3 are wired."""
    marker_level_mv: int = Field(default=1500, ge=-2500, le=2500)
    """Voltage that a marker has to cross."""
    mirror_steps: bool = False
    """Whether the mirror steps by a clock of its own, and its marks are wired to `markers`."""
    pixel_clock: int | None = Field(default=None, ge=1, le=2)
    """AUX OUT (Time Tagger X with its maker's fast-feedback licence) that is wired to the mirror controller's trigger
    input; none: the computer steps the mirror."""

    @classmethod
    def pulse_keys(cls, pulse: Pulse, device: str = "") -> Mapping[str, object] | None:
        """Levels within the instrument's +-2.5 V."""
        return {"level_mv": -300, "edge": "falling"} if pulse == "nim" else {"level_mv": 500, "edge": "rising"}

    @model_validator(mode="after")
    def _one_channel_each(self) -> Self:
        used = [self.sync.channel, self.detector.channel, *self.markers]
        if 0 in used or len({abs(each) for each in used}) != len(used):
            raise ValueError(f"sync, detector and markers need an input each, not channels {used}")
        return self
