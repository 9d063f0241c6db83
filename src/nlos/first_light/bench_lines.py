"""A block of a bench file put into its text, with every other line and comment as it was."""

import re

from nlos.cli.exit_codes import UsageError

_TOP = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*\s*:", re.MULTILINE)


def with_block(text: str, key: str, lines: list[str]) -> str:
    """`text` with the top-level block `key` replaced, or added before `simulation` and the comments that lead to it, or
    at the end. `lines`: the whole block, its key included."""
    block = "\n".join(lines) + "\n"
    starts = list(_TOP.finditer(text))
    for index, found in enumerate(starts):
        if found[0].rstrip(" \t:") == key:
            end = starts[index + 1].start() if index + 1 < len(starts) else len(text)
            return text[: found.start()] + block + _comments_before_next(text[found.start() : end]) + text[end:]
    before = next((found.start() for found in starts if found[0].startswith("simulation")), len(text))
    before -= len(_comments_before_next(text[:before])) if before < len(text) else 0
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


def with_keys(text: str, block: str, values: dict[str, str]) -> str:
    """`text` with keys of the top-level `block` set: those that are there keep their comments. Raises `UsageError` for
    a block that is not written one key a line."""
    starts = list(_TOP.finditer(text))
    index = next((k for k, found in enumerate(starts) if found[0].rstrip(" \t:") == block), None)
    if index is None:
        return with_block(text, block, [f"{block}:", *(f"  {key}: {value}" for key, value in values.items())])
    end = starts[index + 1].start() if index + 1 < len(starts) else len(text)
    lines = text[starts[index].start() : end].splitlines()
    if lines[0].split("#")[0].strip() != f"{block}:":
        raise UsageError(f"{block}: is not written one key a line; put these values in by hand")
    left = dict(values)
    for number, line in enumerate(lines):
        key = line.split(":")[0].strip()
        if line.startswith("  ") and not line.startswith("   ") and key in left:
            value, hash_, comment = line.partition("#")
            wide = len(value.rstrip())
            new = f"  {key}: {left.pop(key)}"
            lines[number] = f"{new.ljust(max(wide, len(value) - 1))} {hash_}{comment}" if hash_ else new
    last = max(k for k, line in enumerate(lines) if line.startswith(" ") or k == 0)
    lines[last + 1 : last + 1] = [f"  {key}: {value}" for key, value in left.items()]
    return text[: starts[index].start()] + "\n".join(lines) + "\n" + text[end:]
