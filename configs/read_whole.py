"""A settings file's bytes; what a disk does not give says nothing of what is in the file."""

from pathlib import Path


class ConfigNotRead(OSError):
    """A file that its disk does not give, or not to this user."""


def read_whole(path: Path) -> bytes:
    """Raises `FileNotFoundError`, and `ConfigNotRead` for whatever else keeps the file from being read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ConfigNotRead(
            f"{path}: cannot be read ({error.strerror}), which says nothing about what is in it. See to its disk and "
            "to who may read it, or copy it to a sound disk, and try again there."
        ) from error
