"""A file as it was when a result was made of it, and whether it still is."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

BLOCK = 1 << 20


def stamp(run: Path) -> dict[str, Any] | None:
    """A file as it is now: where, how long, of when, and the SHA-256 of what it holds; None where it is no file."""
    try:
        now = run.stat()
        held = sha256(run)
    except OSError:
        return None
    return {"path": str(run.absolute()), "bytes": now.st_size, "modified_ns": now.st_mtime_ns, "sha256": held}


def changed(before: Mapping[str, Any], run: Path) -> bool:
    """Whether a file holds something else than at its stamp. A copy of it does not, nor does one that is gone."""
    try:
        now = run.stat()
    except OSError:
        return False
    if now.st_size != before["bytes"]:
        return True
    return bool(now.st_mtime_ns != before["modified_ns"] and sha256(run) != before["sha256"])


def sha256(path: Path) -> str:
    """Of the file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
