"""Lines of two columns on a terminal: what is too long for it goes on under its own column, broken between words."""

import re
import shutil
import sys
import textwrap
import unicodedata

from nlos.cli.escaped import escaped

_LABEL = re.compile(r"(?:\s*\S+ {2,}|\S{10} )(?=\S)")
"""What stands before the second column; a word of ten letters fills the first one of `nlos plan`."""


def columns_shown() -> int | None:
    """How many letters a line of stdout holds; None where it is no terminal, so files and pipes get whole lines."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def one_line(text: str) -> str:
    """A name as a cell of a table shows it: what would end the line or leave the column is written, too."""
    return escaped(text).replace("\n", r"\n").replace("\t", r"\t")


def width_shown(text: str) -> int:
    """How many columns of a terminal it takes: two for a letter of East Asia, none for an accent on the one before."""
    return sum(
        0 if unicodedata.combining(each) else 2 if unicodedata.east_asian_width(each) in "WF" else 1 for each in text
    )


def padded(text: str, width: int) -> str:
    """`text` with spaces behind it, so that the next column begins where it is to begin."""
    return text + " " * (width - width_shown(text))


def folded(text: str, columns: int | None) -> str:
    """`text` with every line that has a second column, and is longer than `columns`, in as many as it needs. Others
    stay as they are, so that a path or a command can be copied whole."""
    if columns is None:
        return text
    lines: list[str] = []
    for line in text.split("\n"):
        label = _LABEL.match(line)
        if len(line) <= columns or label is None or label.end() > columns // 2:
            lines.append(line)
        else:
            under = " " * label.end()
            lines += textwrap.wrap(
                line, columns, subsequent_indent=under, break_long_words=False, break_on_hyphens=False
            )
    return "\n".join(lines)
