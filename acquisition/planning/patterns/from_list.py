"""List: points from a file, for patterns that somebody else computed."""

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.positions import Positions, free, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings

MAX_BYTES = 64 << 20
MAX_POINTS = 1_000_000
MOST_SHOWN = 60


class FromList(Settings):
    """Points from a CSV file with a header line: columns `x_m,y_m`, or `row,col` of the wall's grid."""

    kind: Literal["list"] = "list"
    file: str
    """The CSV file, relative to the current folder."""

    def points(self, wall: WallGrid) -> Positions:
        """In the file's order. Raises `InvalidData` naming file and line."""
        path = Path(self.file)
        if not path.is_file():
            raise InvalidData(f"{path}: no such file; a relative path starts where the command is called")
        if path.stat().st_size > MAX_BYTES:
            raise InvalidData(f"{path}: is larger than {MAX_BYTES >> 20} MB")
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as text:  # Excel's begins with a mark
            lines = csv.reader(text)
            try:
                header = [word.strip() for word in next(lines, [])]
                if header not in (["x_m", "y_m"], ["row", "col"]):
                    raise InvalidData(f"{path}:1: the header is {_shown(header)}, not x_m,y_m or row,col")
                columns = _columns(path, lines, wall if header == ["row", "col"] else None)
            except csv.Error as error:
                raise InvalidData(f"{path}:{lines.line_num}: is no line of a CSV file ({error})") from error
        return free(*columns) if header == ["x_m", "y_m"] else pixels(wall, *columns)


def _columns(path: Path, lines: Iterable[list[str]], grid: WallGrid | None) -> tuple[list[float], list[float]]:
    """Both columns; of pixels where there is a `grid`. Raises `InvalidData` naming file and line, and `csv.Error`."""
    first: list[float] = []
    second: list[float] = []
    for line, fields in enumerate(lines, 2):
        if not fields:
            continue
        try:
            a, b = (float(field) if grid is None else int(field) for field in fields)
        except ValueError as error:
            raise InvalidData(f"{path}:{line}: {_shown(fields)} is not two numbers") from error
        if grid is not None and not (0 <= a < grid.rows and 0 <= b < grid.cols):
            raise InvalidData(f"{path}:{line}: {_shown(fields)} lies outside the grid of {grid.rows} x {grid.cols}")
        if not (math.isfinite(a) and math.isfinite(b)):
            raise InvalidData(f"{path}:{line}: {_shown(fields)} is not finite")
        if len(first) >= MAX_POINTS:
            raise InvalidData(f"{path}:{line}: more than {MAX_POINTS} points")
        first.append(a)
        second.append(b)
    if not first:
        raise InvalidData(f"{path}: holds no points")
    return first, second


def _shown(fields: list[str]) -> str:
    """A line for people, the beginning of a long one."""
    text = ",".join(fields)
    return repr(text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}...")
