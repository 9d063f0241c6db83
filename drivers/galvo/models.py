"""Every mirror controller that a bench file may name: one line per model."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from nlos.drivers.clock import Clock
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.galvo.optotune.mirror import Optotune, OptotuneSettings
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.link.serial_line import WireLog

MirrorSettings = Annotated[TriggerScopeSettings | OptotuneSettings, Field(discriminator="model")]

_OPEN: dict[str, Callable[[Any, Clock, WireLog | None], GalvoMirror]] = {
    "triggerscope": TriggerScope.open,
    "optotune": Optotune.open,
}


def open_mirror(settings: MirrorSettings, clock: Clock, wire_log: WireLog | None = None) -> GalvoMirror:
    """The controller that a bench file's `mirror` block names, opened and centred. Raises `DeviceError`."""
    return _OPEN[settings.model](settings, clock, wire_log)
