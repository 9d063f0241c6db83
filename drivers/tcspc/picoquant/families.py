"""PicoHarp 300, HydraHarp 400 and MultiHarp 150: what their libraries have in common, and where they differ.

From the libraries' manuals and header files: version 3 of each, and version 4 of MHLib, which has the same signatures
and wants the same order for every call made here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.tcspc.block import CounterBlock, Pulse
from nlos.drivers.tcspc.t3 import GENERIC, PICOHARP_300, T3Format

Device = Literal["picoharp300", "hydraharp400", "multiharp150"]

_SLOWEST_DIVIDED_HZ = 1e6
_METER = 1.01
"""So much may a rate meter be off."""


@dataclass(frozen=True)
class Family:
    """One line of instruments and its library."""

    product: str
    prefix: str
    linux_library: str
    windows_library: str
    package: str
    library_versions: tuple[str, ...]
    layout: T3Format
    fixed_bins: int | None
    """Histograms always have so many bins; None: 1024 to 65536 by a length code."""
    shortest_length_code: int
    most_binning_codes: int
    sync_dividers: tuple[int, ...]
    most_sync_hz: float
    """Of what the sync divider lets through."""
    offset_unit_s: float
    largest_offset: int
    most_fifo_records: int
    fifo_takes_count: bool
    longest_marker_holdoff_ns: int
    largest_count: int
    """Of one histogram bin."""
    fifo_full: int
    overflow: int
    sync_lost: int
    system_error: int
    counts_dropped: int
    constant_fraction: bool
    """Inputs have constant-fraction discriminators and need calibration; otherwise edge triggers."""
    nim_level_mv: int
    """What a NIM pulse (0 to -0.8 V) crosses: for a discriminator its magnitude, for an edge trigger the voltage."""
    levels_mv: tuple[int, int]
    trigger_output: bool
    marker_input_most_v: float | None
    """Above it the inputs take damage; None: 5 V TTL."""
    most_zero_cross_mv: int = 40
    rates_valid_s: float = 0.2
    """After the inputs were set up; until then rate meters hold nothing (the demo programs: 100, 400, 150 ms)."""

    def divider_for(self, sync_hz: float) -> int | None:
        """The smallest sync divider with which no pulse is missed; None where there is none."""
        return next((each for each in self.sync_dividers if sync_hz / each <= _METER * self.most_sync_hz), None)

    def sync_misfit(self, divider: int, sync_hz: float) -> tuple[str, str] | None:
        """What is wrong where a laser and the sync divider do not go together, and what to do.

        Behind its divider the sync input is blind for 1 / `most_sync_hz` after a pulse; the instrument reckons the
        pulses in between, in histograms, in T3 records and on its rate meter alike, which takes a laser of 1 MHz or
        more (manuals of PHLib, HHLib and MHLib, SetSyncDiv and warnings; HydraHarp 400 manual, T3 mode).
        """
        laser = f"the laser pulses at {sync_hz / 1e6:.6g} MHz"
        if sync_hz / divider > _METER * self.most_sync_hz:
            most_hz, fits = divider * self.most_sync_hz, self.divider_for(sync_hz)
            return (
                f"{laser}; with sync_divider {divider} a {self.product} takes {most_hz / 1e6:g} MHz and would miss "
                "pulses.",
                f"Set sync_divider: {fits} in the bench file." if fits else "Divide the sync signal before its input.",
            )
        if divider > 1 and sync_hz * _METER < _SLOWEST_DIVIDED_HZ:
            return (
                f"{laser}: below {_SLOWEST_DIVIDED_HZ / 1e6:g} MHz the pulses that sync_divider {divider} leaves out "
                "are not reckoned.",
                "Set sync_divider: 1 in the bench file.",
            )
        return None


FAMILIES: dict[str, Family] = {
    "picoharp300": Family(
        "PicoHarp 300", "PH", "libph300.so", "phlib64.dll", "PicoHarp software and PHLib, version 3", ("3",),
        PICOHARP_300, 65536, 0, 8, (1, 2, 4, 8), 10e6, 1e-12, 10**9, 131_072, True, 210_480, 65_535,
        0x0003, 0x0040, 0, 0x0100, 0, True, 100, (0, 800), False, None, 20,
    ),
    "hydraharp400": Family(
        "HydraHarp 400", "HH", "libhh400.so", "hhlib64.dll", "HydraHarp software and HHLib, version 3", ("3",),
        GENERIC, None, 0, 26, (1, 2, 4, 8, 16), 12.5e6, 1e-9, 500_000, 131_072, True, 524_296, 2**32 - 1,
        0x0002, 0x0001, 0x0004, 0x0010, 0, True, 100, (0, 1000), False, None, rates_valid_s=0.5,
    ),
    "multiharp150": Family(
        "MultiHarp 150", "MH", "libmh150.so", "mhlib64.dll", "MultiHarp software and MHLib, version 3 or 4",
        ("3", "4"),
        GENERIC, None, 2, 24, (1, 2, 4, 8, 16), 78e6, 1e-9, 10**8, 1_048_576, False, 25_500, 2**32 - 1,
        0x0002, 0x0001, 0x0004, 0x0010, 0x0040, False, -50, (-1200, 1200), True, 3.3,
    ),
}  # fmt: skip


class PicoquantInput(Settings):
    """Sync or detector input."""

    level_mv: int | None = Field(default=None, ge=-1200, le=1200)
    """Discriminator level (PicoHarp, HydraHarp: the magnitude of a negative pulse) or edge trigger level (MultiHarp);
    unless given, one that a NIM pulse crosses: 100, and -50 for the MultiHarp."""
    zero_cross_mv: int = Field(default=10, ge=0, le=40)
    """Of the discriminator (PicoHarp, HydraHarp)."""
    edge: Literal["rising", "falling"] = "falling"
    """Which edge counts (MultiHarp)."""
    offset_ps: int = Field(default=0, ge=-99_999, le=99_999)
    """Added to this input's times, as a cable would; of a PicoHarp to the sync's alone."""

    def level_of(self, family: Family) -> int:
        """The level that is set on an instrument of this family."""
        return family.nim_level_mv if self.level_mv is None else self.level_mv


class PicoquantSettings(CounterBlock):
    """The counter block of a bench file."""

    cable: ClassVar = "library"
    incidental: ClassVar[frozenset[str]] = CounterBlock.incidental | {
        "mode", "levels_converted", "marker_holdoff_ns", "marker_disorder_us"}  # fmt: skip
    listing_begins_s: ClassVar[float] = 0.002
    listing_ends_s: ClassVar[float] = 0.0068

    usual_mode: ClassVar[str | None] = "t3"
    """A point of histogram mode lasts whole milliseconds and is started by the host."""

    model: Literal["picoquant"]
    device: Device
    """Which family of instruments, each with a library of its own."""
    library: str = "vendor"
    """Its path, "vendor" (found where its installer puts it), or "simulated"."""
    serial: str = "auto"
    """Serial number of the instrument, or "auto" for the only one that answers."""
    mode: Literal["histogram", "t3"] = "histogram"
    """Histograms made by the instrument, or by this computer from a record of every photon."""
    input: int = Field(default=1, ge=1, le=64)
    """The detector's input, as printed on the front panel."""
    sync: PicoquantInput = PicoquantInput()
    """The laser's synchronisation input."""
    detector: PicoquantInput = PicoquantInput()
    """The single-photon detector's input."""
    sync_divider: Literal[1, 2, 4, 8, 16] = 1
    """For a laser faster than the sync input (10 MHz PicoHarp, 12.5 MHz HydraHarp, 78 MHz MultiHarp): only every N-th
    pulse is timed, the instrument reckons those between. Times are after the last pulse, as without it."""
    levels_converted: bool = False
    """Divider and stretcher are in the cables from and to the mirror controller: `nlos doctor` says which."""
    marker_holdoff_ns: int = Field(default=1000, ge=0)
    """Edges of one marker input closer together than this are taken for one."""
    marker_disorder_us: float = Field(default=50.0, ge=0, le=10_000)
    """How much later than photons of the same time a marker may appear in the record stream."""

    @classmethod
    def pulse_keys(cls, pulse: Pulse, device: str = "") -> Mapping[str, object] | None:
        """The family's own levels (vendor's manuals); None where its inputs take no such pulses. TTL pulses come
        through an attenuator: a MultiHarp's inputs take 1.2 V."""
        family = FAMILIES[device]
        if family.constant_fraction:  # their inputs take negative pulses only
            return {"level_mv": family.nim_level_mv} if pulse == "nim" else None
        return {"level_mv": -50, "edge": "falling"} if pulse == "nim" else {"level_mv": 300, "edge": "rising"}

    @classmethod
    def laser_keys(cls, repetition_hz: float, device: str = "") -> Mapping[str, object]:
        """The divider with which no pulse is missed."""
        divider = FAMILIES[device].divider_for(repetition_hz) or 1
        return {} if divider == 1 else {"sync_divider": divider}

    def laser_misfit(self, repetition_hz: float) -> str:
        """By the bench file's own word: the rate meter counts no pulse that was missed."""
        return " ".join(FAMILIES[self.device].sync_misfit(self.sync_divider, repetition_hz) or ())

    @property
    def channel(self) -> int:
        """The detector's input as the library counts: from 0."""
        return self.input - 1

    @property
    def marker_input_most_v(self) -> float | None:
        """The highest voltage that the marker inputs stand."""
        return FAMILIES[self.device].marker_input_most_v

    @property
    def clock_output(self) -> str:
        """What the pixel clock looks like, empty where there is none."""
        return "NIM" if FAMILIES[self.device].trigger_output else ""

    @model_validator(mode="before")
    @classmethod
    def _inputs_as_printed(cls, given: Any) -> Any:
        if isinstance(given, dict) and "channel" in given:
            channel = given["channel"]
            written = channel + 1 if isinstance(channel, int) else "its number"
            raise ValueError(
                f"`channel` counted inputs from 0; write `input: {written}`, the number printed on the front panel"
            )
        return given

    @model_validator(mode="after")
    def _nothing_is_left_out(self) -> Self:
        """A value that no call of the library would take is no setting of this instrument."""
        family = FAMILIES[self.device]
        if family.prefix == "PH" and self.input != 1:
            raise ValueError(f"input {self.input}: a {family.product} has input 1 alone beside its sync, input 0")
        if family.prefix == "PH" and self.detector.offset_ps:
            raise ValueError(f"detector.offset_ps: a {family.product} moves its sync alone; set sync.offset_ps instead")
        for name, each in (("sync", self.sync), ("detector", self.detector)):
            if family.constant_fraction and each.edge == "rising":
                raise ValueError(f"{name}.edge rising: the discriminators of a {family.product} take negative pulses")
            if not family.constant_fraction and each.zero_cross_mv != PicoquantInput().zero_cross_mv:
                raise ValueError(f"{name}.zero_cross_mv: a {family.product} has edge triggers, no discriminators")
        return self

    @model_validator(mode="after")
    def _levels_exist(self) -> Self:
        family = FAMILIES[self.device]
        low, high = family.levels_mv
        for name, each in (("sync", self.sync), ("detector", self.detector)):
            if not low <= each.level_of(family) <= high:
                raise ValueError(f"{name}.level_mv {each.level_mv} is outside {low} to {high} mV of a {family.product}")
            if each.zero_cross_mv > (most := family.most_zero_cross_mv):
                raise ValueError(f"{name}.zero_cross_mv {each.zero_cross_mv} is above {most} mV of a {family.product}")
        return self
