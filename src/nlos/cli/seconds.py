"""Times that a person gives a verb."""

import math
import re

from nlos.cli.exit_codes import UsageError

_NUMBER = r"[0-9]+(?:\.[0-9]*)?|\.[0-9]+"


def check_seconds(option: str, seconds: float | None, *, may_be_none_at_all: bool = True) -> None:
    """Raises `UsageError` for a time that is below 0 or no number; for 0, too, where that would be no time at all."""
    if seconds is None or seconds > 0 or (seconds == 0 and may_be_none_at_all):
        return
    raise UsageError(f"{option} {seconds:g}: seconds are expected, {'0 or more' if may_be_none_at_all else 'above 0'}")


def with_error(option: str, text: str) -> tuple[float, float]:
    """A number, 0 or more, and its standard error: as given (`77+-2`), else that of a number rounded to its last digit
    (`77`: anywhere in 76.5 to 77.5, so 1 / sqrt(12)); of 0, none. Raises `UsageError`."""
    read = re.fullmatch(rf"\s*({_NUMBER})(?:\s*(?:\+-|\+/-|±)\s*({_NUMBER}))?\s*", text)
    if read is None:
        raise UsageError(f"{option} {text}: a number is expected, 0 or more, with its standard error if known: 77+-2")
    value = float(read[1])
    if read[2] is not None:
        return value, float(read[2])
    return value, 10.0 ** -len(read[1].partition(".")[2]) / math.sqrt(12) if value > 0 else 0.0
