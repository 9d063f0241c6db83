"""What readers, calibration and methods say names options of the command line; Python is told by its arguments."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from nlos.recon.errors import ReconError

_WARNING = ("loaded", "chain", "file_doubts", "bench_constants")
"""Modules behind `nlos.load` and `nlos.reconstruct` whose warnings name options."""
_COMMANDS = ("`nlos reconstruct` and `nlos import` also take", "`nlos.load` and `nlos.reconstruct` also take")
_WORDS = [
    (re.compile(pattern), said)
    for pattern, said in (
        (r" \((?:in Python [\w=]+|[\w, ]+ in Python)\)", ""),  # both are named there
        (r"--bin-width-ps PS\b", "bin_width=SECONDS"),
        (r"--wall-size-m W or WxH\b", "wall=W or wall=(W, H)"),
        (r"--axes ([TYXHWN]+)\b", r"axes='\1'"),
        (r"--raw\b", "rectified=False"),
        (r"--rectified\b", "rectified=True"),
        (r"--detector (N\b|-?\d+)", r"detector=\1"),
        (r"--device (\w+):", r"device='\1':"),
        (r"--constants none\b", "constants='none'"),
        (r"--weights (\S+), in --methods as \S+", r"weights='\1'"),
        (r"--set offsets=file\b", "offsets='file'"),
        (r"--set (\w+=)", r"\1"),
        (r"with --set\b", "with keyword arguments"),
        (r" with -o\b", ""),
        (r"\buse (--overwrite)\b", r"pass \1"),
        (r"--(?:resume|overwrite|no-shutter)\b", lambda found: f"{_argument(found)}=True"),
        (r"--wall-size-m\b", "wall"),
        (r"--bin-width-ps\b", "bin_width"),
        (r"--[a-z][a-z-]*[a-z]\b", lambda found: _argument(found)),
    )
]
_in_python: ContextVar[bool] = ContextVar("in_python", default=False)


def _argument(found: re.Match[str]) -> str:
    return found[0].removeprefix("--").replace("-", "_")


def in_python(text: str) -> str:
    """The text with Python's arguments in the place of options; commands in backticks are left as they are."""
    parts = re.split(r"(`[^`]*`)", text.replace(*_COMMANDS))
    for at in range(0, len(parts), 2):
        for pattern, said in _WORDS:
            parts[at] = pattern.sub(said, parts[at])
    return "".join(parts)


@contextmanager
def said_in_python() -> Iterator[None]:
    """Errors and warnings of what is called within, or of the function that it decorates, in Python's words."""
    before = _in_python.set(True)
    try:
        yield
    except (OSError, ValueError, ReconError) as error:
        if len(error.args) == 1 and isinstance(error.args[0], str):
            error.args = (in_python(error.args[0]),)
        raise
    finally:
        _in_python.reset(before)


def _translate(record: logging.LogRecord) -> bool:
    if _in_python.get():
        record.msg, record.args = in_python(record.getMessage()), None
    return True


for _module in _WARNING:
    logging.getLogger(f"nlos.{_module}").addFilter(_translate)
