"""Every mirror controller that a bench file may name: ours, one line a model, and those of installed packages."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import DeviceModel, WireLog
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.helios.model import HELIOS
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.galvo.optotune.model import OPTOTUNE
from nlos.drivers.galvo.triggerscope.model import TRIGGERSCOPE
from nlos.drivers.plug_in_device import Contract
from nlos.drivers.plug_ins import with_plug_ins
from nlos.drivers.wire_log import unfailing

MIRRORS: dict[str, DeviceModel[GalvoMirror]] = with_plug_ins(
    "nlos.mirrors",
    MirrorBlock,
    Contract(GalvoMirror),
    [
        TRIGGERSCOPE,
        OPTOTUNE,
        HELIOS,
    ],
)
"""Word in a bench file -> what that model brings with it."""

if TYPE_CHECKING:
    MirrorSettings = MirrorBlock
else:
    _BLOCKS = reduce(or_, (model.settings for model in MIRRORS.values()))
    MirrorSettings = Annotated[_BLOCKS, Field(discriminator="model")]


def open_mirror(
    settings: MirrorSettings, clock: Clock, wire_log: WireLog | None = None, backend: Any = None
) -> GalvoMirror:
    """The controller that a bench file's `mirror` block names, opened and centred. Raises `DeviceError`.

    `backend` is what replaces libusb, where the controller needs it: the simulated bench's, or None for the real
    one.
    """
    return MIRRORS[settings.model].open(settings, clock, backend, unfailing(wire_log))
