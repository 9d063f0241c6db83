"""Sizes in words, to tenths of a megabyte: what is needed rounded up, what there is down, so that a refusal for want of
room never reads as if there were enough."""

import math


def needed(size: int) -> str:
    """Of `size` bytes: "0.1 MB" of a single one."""
    return _shown(math.ceil(size / 1e5))


def free(size: int) -> str:
    """Of `size` bytes: "49.9 MB" of one less than 50 million."""
    return _shown(size // 10**5)


def _shown(tenths: int) -> str:
    return f"{tenths / 10:.1f}".removesuffix(".0") + " MB"
