"""Models of devices that come in packages of their own, found by entry point."""

import logging
from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from nlos.drivers.device_model import DeviceModel
from nlos.drivers.device_settings import DeviceSettings

_log = logging.getLogger(__name__)

_BROKEN = (
    ImportError,
    SyntaxError,
    NameError,
    AttributeError,
    TypeError,
    ValueError,
    LookupError,
    OSError,
    RuntimeError,
)
"""What importing a package that does not fit this version, this Python or this computer raises."""


def with_plug_ins(
    group: str, block: type[DeviceSettings], own: Iterable[DeviceModel[Any]]
) -> dict[str, DeviceModel[Any]]:
    """Word in a bench file -> model: our own, then those of installed packages. One that cannot be used is named in a
    warning and skipped: the others still work."""
    models = {each.name: each for each in own}
    for point in sorted(entry_points(group=group), key=lambda each: (each.name, each.value)):
        try:
            model = _loaded(point, block)
            if model.name in models:
                raise ValueError(f"a model {model.name} already exists")
        except _BROKEN as error:
            package = point.dist.name if point.dist else "an unnamed package"
            _log.warning(
                "%s %s of %s cannot be used: %s. Update or remove %s.", group, point.name, package, error, package
            )
            continue
        models[model.name] = model
    return models


def _loaded(point: EntryPoint, block: type[DeviceSettings]) -> DeviceModel[Any]:
    model = point.load()
    if not isinstance(model, DeviceModel):
        raise TypeError(f"{point.value} is not an nlos.drivers.device_model.DeviceModel")
    if not issubclass(model.settings, block):
        raise TypeError(f"{model.settings.__name__} does not derive from {block.__module__}.{block.__name__}")
    _ = model.name, model.settings.cable  # a block that narrows no word or names no cable is refused here
    return model
