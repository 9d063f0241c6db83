"""Times that a person gives a verb."""

from nlos.cli.exit_codes import UsageError


def check_seconds(option: str, seconds: float | None, *, may_be_none_at_all: bool = True) -> None:
    """Raises `UsageError` for a time that is below 0 or no number; for 0, too, where that would be no time at all."""
    if seconds is None or seconds > 0 or (seconds == 0 and may_be_none_at_all):
        return
    raise UsageError(f"{option} {seconds:g}: seconds are expected, {'0 or more' if may_be_none_at_all else 'above 0'}")
