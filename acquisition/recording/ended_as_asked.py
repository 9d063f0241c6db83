"""A scan that was to end once its picture is good enough, and did: its points are fewer than planned, and it is not one
that somebody broke off. Its events tell."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from nlos.acquisition.recording.layout import Status

if TYPE_CHECKING:
    from nlos.acquisition.recording.recording import Recording

KIND, NOTHING_LEFT = "scan", "ended early: there is nothing left to gain"
"""The event of a scan that ends because whoever decides says so."""
AS_ASKED = "ended as asked"


def status_word(recording: "Recording") -> str:
    """What `nlos` calls the status of a recording."""
    return word_of(recording.status, ((event.kind, event.text) for event in recording.events()))


def word_of(status: Status, events: Iterable[tuple[str, str]]) -> str:
    """The same from the (kind, text) of its events."""
    word = status.name.lower()
    if status is not Status.INTERRUPTED:
        return word
    said = [text for kind, text in events if kind == KIND]
    return AS_ASKED if said[-2:] == [NOTHING_LEFT, word] else word  # resumed since, it says more in between or after
