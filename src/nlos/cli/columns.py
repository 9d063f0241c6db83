"""Lines of two columns on a terminal: what is too long for it goes on under its own column, broken between words."""

import re
import shutil
import sys
import textwrap

_LABEL = re.compile(r"(?:\s*\S+ {2,}|\S{10} )(?=\S)")
"""What stands before the second column; a word of ten letters fills the first one of `nlos plan`."""


def columns_shown() -> int | None:
    """How many letters a line of stdout holds; None where it is no terminal, so files and pipes get whole lines."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


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
