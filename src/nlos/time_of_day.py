"""What the clock on the wall will show when something is over."""

from datetime import UTC, datetime, timedelta


def shown_after(seconds: float, now: datetime | None = None) -> str:
    """`Sun 07:00`: this computer's local time so many `seconds` after `now`, an aware moment, the present unless given.
    A night in which the clocks are changed is an hour longer or shorter."""
    return f"{((now or datetime.now(UTC)) + timedelta(seconds=seconds)).astimezone():%a %H:%M}"
