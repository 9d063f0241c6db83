"""Models of devices that come in packages of their own, found by entry point."""

import logging
import sys
from collections.abc import Iterable, Mapping
from contextlib import redirect_stdout
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.device_settings import ADDRESS_KEYS, DeviceSettings
from nlos.drivers.plug_in_device import Contract, held

_log = logging.getLogger(__name__)


def with_plug_ins(
    group: str, block: type[DeviceSettings], contract: Contract, own: Iterable[DeviceModel[Any]]
) -> dict[str, DeviceModel[Any]]:
    """Word in a bench file -> model: our own, then those of installed packages, whose devices are held to `contract`.
    One that cannot be used is named in a warning and skipped: the others still work."""
    models = {each.name: each for each in own}
    for point in sorted(entry_points(group=group), key=lambda each: (each.name, each.value)):
        package = point.dist.name if point.dist else "an unnamed package"
        try:
            with redirect_stdout(sys.stderr):  # what it prints is no result of a command
                model = _loaded(point, block)
            _check_free(model, models)
            model = held(model, contract, package)
        except (Exception, SystemExit) as error:  # importing it runs it, and it may raise anything, or try to end
            said = str(error) if isinstance(error, ImportError | Unusable) else f"{type(error).__name__}: {error}"
            _log.warning(
                "%s %s of %s cannot be used: %s. Update or remove %s.", group, point.name, package, said, package
            )
            continue
        models[model.name] = model
    return models


class Unusable(Exception):
    """It does not keep what `DeviceModel` asks for."""


def _loaded(point: EntryPoint, block: type[DeviceSettings]) -> DeviceModel[Any]:
    model = point.load()
    if not isinstance(model, DeviceModel):
        raise Unusable(f"{point.value} is not an nlos.drivers.device_model.DeviceModel")
    settings = model.settings
    if not (isinstance(settings, type) and issubclass(settings, block)):
        raise Unusable(f"{_named(settings)} does not derive from {block.__module__}.{block.__name__}")
    words = get_args(settings.model_fields["model"].annotation)
    if len(words) != 1 or not isinstance(words[0], str):
        raise Unusable(f'{settings.__name__} needs `model: Literal["its word"]`, one word')
    key = ADDRESS_KEYS.get(getattr(settings, "cable", None))  # type: ignore[arg-type]
    if key is None:
        raise Unusable(f"{settings.__name__} needs `cable: ClassVar = ...`, one of {', '.join(ADDRESS_KEYS)}")
    if key not in settings.model_fields:
        raise Unusable(f"{settings.__name__} has no key `{key}`, the address of its cable `{settings.cable}`")
    for word, output in model.shutters.items():
        if not isinstance(output, ShutterOutput):
            raise Unusable(f"its shutter {word} is not an nlos.drivers.device_model.ShutterOutput")
    return model


def _check_free(model: DeviceModel[Any], others: Mapping[str, DeviceModel[Any]]) -> None:
    if model.name in others:
        raise Unusable(f"a model {model.name} already exists")
    taken = {"none", *(word for other in others.values() for word in other.shutters)}
    if twice := taken & model.shutters.keys():
        raise Unusable(f"a shutter {', '.join(sorted(twice))} already exists")


def _named(found: object) -> str:
    return str(getattr(found, "__name__", found))
