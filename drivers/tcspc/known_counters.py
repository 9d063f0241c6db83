"""Every photon counter that a bench file may name: ours, one line a model, and those of installed packages."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import DeviceModel, WireLog
from nlos.drivers.plug_in_device import Contract
from nlos.drivers.plug_ins import with_plug_ins
from nlos.drivers.tcspc.block import CounterBlock
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.handed_over import answers_misfit
from nlos.drivers.tcspc.picoquant.model import PICOQUANT
from nlos.drivers.tcspc.tcspc488.model import TCSPC488
from nlos.drivers.tcspc.timetagger.model import TIMETAGGER
from nlos.drivers.wire_log import unfailing

COUNTERS: dict[str, DeviceModel[HistogramCounter]] = with_plug_ins(
    "nlos.counters",
    CounterBlock,
    Contract(HistogramCounter, answers_misfit),
    [
        TCSPC488,
        PICOQUANT,
        TIMETAGGER,
    ],
)
"""Word in a bench file -> what that model brings with it."""

if TYPE_CHECKING:
    CounterSettings = CounterBlock
else:
    _BLOCKS = reduce(or_, (model.settings for model in COUNTERS.values()))
    CounterSettings = Annotated[_BLOCKS, Field(discriminator="model")]


def open_counter(
    settings: CounterSettings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
) -> HistogramCounter:
    """The counter that a bench file's `counter` block names, opened and configured. Raises `DeviceError`.

    `backend` replaces libusb or the vendor's library: the simulated bench's, or None for the real one.
    """
    return COUNTERS[settings.model].open(settings, clock, backend, unfailing(wire_log))
