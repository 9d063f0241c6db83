"""Names that some disks take for one: Macs, SMB shares, memory sticks know neither case nor how an accent is made."""

import tempfile
import unicodedata
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path


def folded(name: str) -> str:
    """What names that any disk takes for one have in common: case, how letters are composed, dots at the end."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold()).rstrip(". ")


def taken_for_one(folder: Path, names: Iterable[str]) -> bool:
    """Whether the disk of `folder`, which may have to be made yet, takes two different ones of `names` for one. It is
    asked itself, and only where there are such names; one that takes none of them now is no answer."""
    alike = defaultdict(set)
    for name in names:
        alike[folded(name)].add(name)
    asked = [group for group in alike.values() if len(group) > 1]
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    try:
        return any(_is_one(there, group) for group in asked)
    except OSError:  # whoever writes there says what is wrong with it
        return False


def _is_one(there: Path, names: Iterable[str]) -> bool:
    with tempfile.TemporaryDirectory(dir=there) as trial:
        for name in names:
            try:
                (Path(trial) / name).mkdir()
            except FileExistsError:
                return True
    return False
