"""Where a verb may write, and what it may list: names are looked at before anything is opened, measured or computed."""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from nlos.acquisition.recording.new_name import file_to_write
from nlos.acquisition.recording.no_such_file import meant_by
from nlos.cli.exit_codes import UsageError
from nlos.names_for_one import folded, taken_for_one
from nlos.writable import check_writable

RECORDINGS = (".h5", ".hdf5")
PICTURES = (".png", ".pdf", ".svg")
PAGES = (".html", ".htm")
LOGS = (".csv",)
LONGEST_NAME = 220
"""Bytes. File systems take 255, and what is saved of a recording that somebody deletes has up to 29 more."""


def recording_target(path: Path) -> Path:
    """`path`, a recording that is to be written. Raises `UsageError` for another kind of name or place."""
    _check_kind(path, RECORDINGS, "a recording")
    if (length := len(os.fsencode(path.name))) > LONGEST_NAME and not os.path.exists(path):  # one of before goes on
        raise UsageError(
            f"{path.name[:40]}...: is a name of {length} bytes; files beside it get longer ones, so a recording's has "
            f"{LONGEST_NAME} at most. Choose a shorter one."
        )
    if not path.stem.strip("."):
        raise UsageError(f"{path}: has no name before {path.suffix}. Choose one.")
    _check_folder(path)
    return path


def picture_target(path: Path) -> Path:
    """The same for a picture."""
    _check_kind(path, PICTURES, "a picture")
    _check_folder(path)
    return path


def page_target(path: Path) -> Path:
    """The same for a page."""
    _check_kind(path, PAGES, "a page")
    _check_folder(path)
    return path


def log_target(path: Path, overwrite: bool) -> Path:
    """The same for a log of what was seen, given as `--log`. Raises as `check_place` does."""
    _check_kind(path, LOGS, "a log")
    check_place(path, overwrite, "--log")
    return path


def check_place(path: Path, overwrite: bool, option: str = "-o") -> None:
    """Everything that could refuse a file at `path`, given as `option`, once it is made. Raises as `refuse_existing`
    and `check_writable` do, and `UsageError` where more than its folder is missing."""
    refuse_existing(path, overwrite, option)
    _check_folder(path, option)
    check_writable(file_to_write(path).absolute().parent, option)


def refuse_existing(path: Path, overwrite: bool, option: str = "-o") -> None:
    """Raises `FileExistsError` where something is at `path`, given as `option`, that may not be replaced: a link to
    nothing neither; `IsADirectoryError` for a folder, which never is."""
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder. Name the file in it.")
    if os.path.lexists(path) and not overwrite:
        raise FileExistsError(f"{path}: exists. Choose another name with {option}, or use --overwrite.")


def refuse_own_input(target: Path, inputs: Iterable[Path | None], what: str) -> None:
    """Raises `UsageError` where `target` is one of the files that it is made from, by whatever name: --overwrite means
    an older result, never that. `what` says what such a file is."""
    for file in inputs:
        if file is not None and file.exists() and target.exists() and target.samefile(file):
            raise UsageError(f"{target}: is {what}. Choose another name with -o.")


def names_of(files: Sequence[Path], folder: Path) -> list[str]:
    """What is made of each of several files in `folder` is named by its stem, where two have one by the whole name.
    Raises `UsageError` for two of one name, or of two that the folder's disk takes for one: one result would take the
    other's place."""
    alike = folded if taken_for_one(folder, [word for file in files for word in (file.stem, file.name)]) else str
    stems = Counter(alike(file.stem) for file in files)
    names = [file.stem if stems[alike(file.stem)] == 1 else file.name for file in files]
    held = Counter(map(alike, names))
    if twice := sorted({name for name in names if held[alike(name)] > 1}):
        raise UsageError(f"{', '.join(twice)}: two files of one name. Take them one by one, into folders of their own.")
    return names


def refuse_folder(path: Path) -> None:
    """Raises `IsADirectoryError` for a folder where a file is to be named."""
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder. {meant_by(path) or 'Name a file in it.'}")


def _check_kind(path: Path, suffixes: tuple[str, ...], what: str) -> None:
    if path.suffix.lower() not in suffixes:
        shown = path.suffix or "none"
        raise UsageError(f"{path}: {what} is written as {', '.join(suffixes)} (given {shown}).")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder. Name the file in it.")


def _check_folder(path: Path, option: str = "-o") -> None:
    """One missing folder is made, a missing way to it is a mistake: another disk, or a slip of the pen."""
    folder = path.absolute().parent
    if not folder.is_dir() and (os.path.lexists(folder) or not folder.parent.is_dir()):
        missing = folder if os.path.lexists(folder) else folder.parent  # a link to nothing cannot be made one
        raise UsageError(f"{path}: {missing} is not a folder. Make it first, or choose another place with {option}.")


def check_folder(folder: Path) -> None:
    """Raises `FileNotFoundError` where recordings are to be listed and there is no such folder, or a file."""
    if not folder.is_dir():
        what = "is a file; name the folder that it lies in" if folder.exists() else "no such folder"
        raise FileNotFoundError(f"{folder}: {what}")
