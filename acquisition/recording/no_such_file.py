"""A file that is not there, told with the one that may have been meant."""

import difflib
import os
from pathlib import Path

_ALIKE = 0.8


def no_such_file(path: Path) -> FileNotFoundError:
    """The error for `path`, with `meant_by` it, or with what lies there that is no file to read."""
    if path.exists():
        return FileNotFoundError(
            f"{path}: is a pipe, a device or the like, and only files are read. Save what comes out of it as one."
        )
    if path.is_symlink():
        return FileNotFoundError(f"{path}: is a link to {os.readlink(path)}, and nothing is there")
    return FileNotFoundError(f"{path}: no such file" + (f". {meant}" if (meant := meant_by(path)) else ""))


def meant_by(path: Path) -> str:
    """The question whether a file beside `path` was meant, which is called alike: `run.h5` for `run`, whether or not
    the folder of its results is called so, and for `rn.h5`. Empty where there is none."""
    try:
        with os.scandir(path.parent) as entries:
            names = {each.name.casefold(): each.name for each in entries if not each.name.startswith(".")}
    except OSError:  # no such folder either, or one that may not be listed
        return ""
    asked = path.name.casefold()
    if not asked:
        return ""
    names.pop(asked if path.exists() else "", None)
    longer = sorted((name for name in names if name.startswith(f"{asked}.")), key=lambda name: not name.endswith(".h5"))
    alike = [] if path.exists() else difflib.get_close_matches(asked, names, n=1, cutoff=_ALIKE)
    files = (path.with_name(names[name]) for name in [*longer, *alike])
    found = next((file for file in files if file.is_file()), None)
    return f"Did you mean {found}?" if found else ""
