"""The vendor's package has every function, class and method that the driver calls, with its parameters."""

import inspect
import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

from nlos.drivers.simulated.timetagger import flim, measurements, package

HERE = Path(__file__).parent
DRIVER = Path(inspect.getfile(package)).parents[2] / "tcspc" / "timetagger"
CLASSES = {
    "TimeTagger": package.Instrument,
    **{
        name: getattr(flim if name == "Flim" else measurements, name)
        for name in ("Histogram", "Flim", "TimeTagStream", "Countrate", "Combiner", "DelayedChannel")
    },
    "FlimFrameInfo": flim.FrameInfo,
    "TimeTagStreamBuffer": measurements.TagBuffer,
}
FUNCTIONS = ("scanTimeTagger", "createTimeTagger", "freeTimeTagger")
OF_THE_VENDOR = re.compile(r"^(get|set|is|start|stop|clear|sync|xtra_)")


def ours() -> dict[str, list[str]]:
    """NAME.METHOD -> parameters of the stand-in."""
    found = {name: names(getattr(package.TimeTaggerPackage, name)) for name in FUNCTIONS}
    for name, kind in CLASSES.items():
        for method, function in inspect.getmembers(kind, inspect.isfunction):
            if OF_THE_VENDOR.match(method):
                found[f"{name}.{method}"] = names(function)
        if issubclass(kind, measurements.Measurement | measurements.Combiner | measurements.DelayedChannel):
            found[f"{name}.__init__"] = names(kind.__init__)
    return found


def names(function: Callable[..., object]) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name != "self"]


def test_every_call_exists_with_these_parameters(foreign_python: Callable[..., Path]) -> None:
    python, wanted = foreign_python("Swabian.TimeTagger"), ours()
    command = [str(python), str(HERE / "timetagger" / "signatures.py"), *wanted]
    theirs = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    for path, parameters in wanted.items():
        assert theirs[path] is not None, f"the vendor's package has no {path}"
        assert theirs[path][: len(parameters)] == parameters, path


def test_the_driver_calls_nothing_that_the_stand_in_lacks() -> None:
    offered = {path.rpartition(".")[2] for path in ours()}
    text = "".join(path.read_text("utf-8") for path in DRIVER.glob("*.py"))
    called = {
        *re.findall(r"\b(?:set|call|read)\(\s*(?:\w+, )?\"(\w+)\"", text),
        *re.findall(r"measurement\(\s*\"(\w+)\"", text),
    }
    assert {"startFor", "setConditionalFilter", "Flim", "getHistograms", "xtra_setAuxOut"} <= called
    assert called <= offered | set(CLASSES)
