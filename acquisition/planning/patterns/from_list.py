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
        with path.open(newline="", encoding="utf-8", errors="replace") as text:
            lines = csv.reader(text)
            header = [word.strip() for word in next(lines, [])]
            if header not in (["x_m", "y_m"], ["row", "col"]):
                raise InvalidData(f"{path}:1: the header is {','.join(header)!r}, not x_m,y_m or row,col")
            columns = _columns(path, lines, on_grid=header == ["row", "col"])
        if header == ["x_m", "y_m"]:
            return free(*columns)
        try:
            return pixels(wall, *columns)
        except ValueError as error:
            raise InvalidData(f"{path}: {error}") from error


def _columns(path: Path, lines: Iterable[list[str]], on_grid: bool) -> tuple[list[float], list[float]]:
    first: list[float] = []
    second: list[float] = []
    for line, fields in enumerate(lines, 2):
        if not fields:
            continue
        try:
            a, b = (int(field) if on_grid else float(field) for field in fields)
        except ValueError as error:
            raise InvalidData(f"{path}:{line}: {','.join(fields)!r} is not two numbers") from error
        if not (math.isfinite(a) and math.isfinite(b)):
            raise InvalidData(f"{path}:{line}: {','.join(fields)!r} is not finite")
        if len(first) >= MAX_POINTS:
            raise InvalidData(f"{path}:{line}: more than {MAX_POINTS} points")
        first.append(a)
        second.append(b)
    if not first:
        raise InvalidData(f"{path}: holds no points")
    return first, second
