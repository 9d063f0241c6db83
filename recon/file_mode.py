"""Safetensors files are their owner's alone: weights and kept scenes are for whoever reads their folder."""

from contextlib import suppress
from pathlib import Path


def readable_as_its_folder(path: Path) -> None:
    """Who may look into the folder may read the file, who may write there may write it. File systems without modes keep
    what they have."""
    with suppress(OSError):
        path.chmod(path.parent.stat().st_mode & 0o666)
