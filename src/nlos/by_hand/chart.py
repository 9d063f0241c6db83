"""A histogram in characters: columns of eighths of a line, on a linear or a logarithmic scale."""

import numpy as np
import numpy.typing as npt

_EIGHTHS = " ▁▂▃▄▅▆▇█"
_ASCII = " ..::||##"


def chart(
    counts: npt.NDArray[np.integer], columns: int, rows: int, logarithmic: bool = True, plain: bool = False
) -> list[str]:
    """`rows` lines of `columns` characters. Each column shows the highest of its bins: a peak one bin wide is seen.
    `plain`: for terminals without block characters."""
    marks = _ASCII if plain else _EIGHTHS
    edges = np.linspace(0, len(counts), min(columns, len(counts)) + 1).astype(int)
    tops = np.maximum.reduceat(np.asarray(counts, np.float64), edges[:-1]) if len(counts) else np.zeros(1)
    height = np.log1p(tops) if logarithmic else tops
    eighths = np.rint(height / max(float(height.max()), 1e-9) * 8 * rows).astype(int)
    return ["".join(marks[min(max(each - 8 * row, 0), 8)] for each in eighths) for row in reversed(range(rows))]


def ruler(start_ns: float, end_ns: float, columns: int) -> str:
    """The line below it: where it begins, its middle, its end."""
    left, middle, right = f"{start_ns:.4g}", f"{(start_ns + end_ns) / 2:.4g}", f"{end_ns:.4g} ns"
    gap = max(columns - len(left) - len(middle) - len(right), 2)
    return left + " " * (gap // 2) + middle + " " * (gap - gap // 2) + right
