"""A block of a bench file put into its text, with every other line and comment as it was."""

import re

_TOP = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*\s*:", re.MULTILINE)


def with_block(text: str, key: str, lines: list[str]) -> str:
    """`text` with the top-level block `key` replaced, or added before `simulation`, else at the end. `lines`: the whole
    block, its key included."""
    block = "\n".join(lines) + "\n"
    starts = list(_TOP.finditer(text))
    for index, found in enumerate(starts):
        if found[0].rstrip(" \t:") == key:
            end = starts[index + 1].start() if index + 1 < len(starts) else len(text)
            return text[: found.start()] + block + _comments_before_next(text[found.start() : end]) + text[end:]
    before = next((found.start() for found in starts if found[0].startswith("simulation")), len(text))
    head = text[:before]
    return head + ("" if head.endswith("\n") or not head else "\n") + block + text[before:]


def _comments_before_next(old: str) -> str:
    """Comment lines at a block's end, at the margin, belong to what follows."""
    kept: list[str] = []
    for line in reversed(old.splitlines(keepends=True)):
        if line.strip() and not line.startswith("#"):
            break
        kept.append(line)
    return "".join(reversed(kept))
