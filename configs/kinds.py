"""What kind of file something is where another was wanted: a bench file for a scan, a recording for either."""

from collections.abc import Collection
from typing import Literal

Kind = Literal["bench", "scan", "train", "queue"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_TOLD_BY: dict[Kind, tuple[str, ...]] = {
    "bench": ("mirror", "counter", "shutter", "geometry"),
    "scan": ("wall", "pattern", "histogram"),
    "queue": ("runs",),
    "train": ("method", "learning_rate"),
}
"""Keys that a file of one kind has, and none of another."""


def called(kind: Kind) -> str:
    """In words."""
    return "training file" if kind == "train" else f"{kind} file"


def not_text(kind: Kind, raw: bytes) -> str | None:
    """What to say of a file that is no YAML but a recording or a result."""
    if not raw.startswith(_HDF5):
        return None
    hint = " The scan file comes first; -o names the recording." if kind == "scan" else ""
    return f"is HDF5, as recordings and results are; a {called(kind)} is YAML text.{hint}"


def of_another_kind(kind: Kind, keys: Collection[str]) -> str | None:
    """What to do with a file of these keys that is of another kind; None where it is not surely so."""
    if any(key in keys for key in _TOLD_BY[kind]):
        return None
    for other, told_by in _TOLD_BY.items():
        if all(key in keys for key in told_by):
            how = "Give it as --bench FILE" if other == "bench" else f"`nlos {other} FILE` takes it"
            return f"is a {called(other)} ({', '.join(told_by)}), and a {called(kind)} is wanted here. {how}."
    return None
