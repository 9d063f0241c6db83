"""A device of somebody else's package, held to the contract: what it lacks is said as it is opened, before there is any
light, and whatever it raises becomes a device error, which every way out of a scan knows."""

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, is_dataclass, replace
from functools import partial, wraps
from inspect import isfunction
from math import isfinite
from typing import Any, get_type_hints

import numpy as np

from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.errors import DeviceError, DeviceFault
from nlos.drivers.presence import Presence
from nlos.drivers.shutter import LaserShutter

Misfit = Callable[[str, Sequence[Any], Any], str]
"""(method, what it was given, its answer) -> what is wrong with that; empty where nothing is."""
Judge = Callable[[Sequence[Any], Any], str]
"""The same, of one method."""


@dataclass(frozen=True)
class Contract:
    """What a device has to keep: the methods of `protocol`, their kinds of answers, and what else `misfit` finds in
    the answers of one device, which is told (method, what it was given, its answer)."""

    protocol: type
    misfit: Callable[[], Misfit] = lambda: lambda method, given, answer: ""


def held(model: DeviceModel[Any], contract: Contract, package: str) -> DeviceModel[Any]:
    """The same model of `package`; what it opens keeps `contract`, or `DeviceFault` is raised, of what it lacks with
    the device closed."""
    blamed = _Blamed(model.name, package)

    def open_held(*given: Any) -> Any:
        with blamed():
            device = model.open(*given)
        try:
            return blamed.checked(device, contract)
        except DeviceFault:
            with suppress(Exception):
                device.close()
            raise

    def look_for(settings: Any) -> Presence:
        try:
            with blamed():
                return model.look_for(settings)
        except DeviceFault as error:
            return Presence(False, error.what, error.remedy)

    def shutter(output: ShutterOutput) -> ShutterOutput:
        def of(device: Any) -> Any:
            with blamed():
                made = output.of(device)
            return blamed.checked(made, Contract(LaserShutter))

        return replace(output, of=of)

    return replace(
        model,
        open=open_held,
        firmware=blamed.of(model.firmware),
        look_for=look_for,
        shutters={word: shutter(output) for word, output in model.shutters.items()},
    )


class _Blamed:
    """Whose fault it is, in the words of the error."""

    def __init__(self, model: str, package: str) -> None:
        self._model, self._package = model, package

    @contextmanager
    def __call__(self) -> Iterator[None]:
        try:
            yield
        except DeviceError:
            raise
        except Exception as error:  # it may raise anything; every way out of a scan knows a device error
            if type(error).__module__.partition(".")[0] == "nlos":
                raise  # what we raised while it waited, which it passed on
            said = str(error).rstrip(".")
            raise self._fault(f"its driver raised {type(error).__name__}{_where(error)}: {said}.") from error

    def of(self, function: Callable[..., Any], judge: Judge = lambda given, answer: "") -> Callable[..., Any]:
        """The same function, whose answers are judged."""

        @wraps(function)
        def called(*given: Any, **named: Any) -> Any:
            with self():
                answer = function(*given, **named)
            if wrong := judge(given, answer):
                raise self._fault(f"its driver's answer to {wrong}.")
            return answer

        return called

    def checked(self, made: Any, contract: Contract) -> Any:
        """`made`, whose methods are held from now on. Raises `DeviceFault` where it lacks some."""
        protocol, misfit = contract.protocol, contract.misfit()
        with self():
            lacking = [
                f"{name} (a {'property' if isinstance(promised, property) else 'method'})"
                for name, promised in vars(protocol).items()
                if not name.startswith("_") and _lacks(made, name, promised)
            ]
        if lacking:
            words = ", ".join(lacking)
            raise self._fault(f"its driver {type(made).__name__} lacks {words}, which a {protocol.__name__} has.")
        judged = {
            name: self.of(getattr(made, name), partial(_judge, name, _kind(protocol, name), misfit))
            for name in dir(type(made))
            if not name.startswith("_") and callable(getattr(type(made), name))
        }
        try:
            _put(made, judged)
        except Exception as error:  # how a class says no is its own affair
            raise self._fault(
                f"its driver {type(made).__name__} takes no other methods ({error}), so nobody could judge what it "
                "hands over: a class written in Python is needed."
            ) from error
        return made

    def _fault(self, what: str) -> DeviceFault:
        return DeviceFault(self._model, what, f"Update {self._package}, or tell its authors.")


def _put(made: object, methods: Mapping[str, Callable[..., Any]]) -> None:
    """In the place of its own: in the device itself or, where that takes none, as with slots or frozen, in a class of
    its own. Raises whatever that does where neither is possible."""
    try:
        for name, method in methods.items():
            setattr(made, name, method)
    except Exception:  # AttributeError of Python's own classes, ValueError of pydantic's, or its own
        kept = {name: staticmethod(method) for name, method in methods.items()}
        object.__setattr__(made, "__class__", type(type(made).__name__, (type(made),), {"__slots__": (), **kept}))


def _lacks(made: object, name: str, promised: object) -> bool:
    if isinstance(promised, property):
        return not hasattr(made, name) or callable(getattr(made, name))
    return not callable(getattr(made, name, None))


def _kind(protocol: type, name: str) -> object:
    """What the protocol says that a method gives back; None for methods of its own."""
    promised = getattr(protocol, name, None)
    return get_type_hints(promised).get("return") if isfunction(promised) else None


def _judge(name: str, kind: object, misfit: Misfit, given: Sequence[Any], answer: Any) -> str:
    """Where a number or one of our own values is promised, and the answer is another; then what `misfit` finds."""
    if kind is float and not (isinstance(answer, int | float | np.number) and isfinite(answer)):
        return f"{name}: {answer!r}, no number"
    if isinstance(kind, type) and is_dataclass(kind) and not isinstance(answer, kind):
        return f"{name}: {type(answer).__name__}, no {kind.__name__}"
    wrong = misfit(name, given, answer)
    return wrong and f"{name}: {wrong}"


def _where(error: Exception) -> str:
    """The last line of somebody else's code on the way to it; empty where it was ours that could not call it."""
    frames = [each for each in traceback.walk_tb(error.__traceback__) if not _is_ours(each[0].f_globals)]
    return f" at {frames[-1][0].f_code.co_filename}:{frames[-1][1]}" if frames else ""


def _is_ours(names: dict[str, Any]) -> bool:
    return str(names.get("__name__", "")).partition(".")[0] == "nlos"
