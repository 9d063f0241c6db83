"""Spots on the wall, as `nlos calibrate --spots` reads them: commanded angles, and where a ruler found the beam."""

import csv
import io
import math
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from nlos.calibration.errors import InvalidData
from nlos.drivers.galvo.mirror import MirrorAngles

COLUMNS = ("x_deg", "y_deg", "x_m", "y_m")
SAME_M, OTHER_M = 4e-3, 12e-3
"""On the wall: what is nearer is one place, by a ruler good to a millimetre or two; what is farther is another one."""

_WRITTEN = 1e-4
"""What numbers lose as they are written, at most: degrees and metres."""


@dataclass(frozen=True)
class Mark:
    """One spot: commanded angles, optical degrees; its place on the wall, metres, None where it is to be filled in."""

    line: int
    x_deg: float
    y_deg: float
    place_m: tuple[float, float] | None

    def contradicts(self, other: "Mark", wall_distance_m: float) -> bool:
        """Whether one scanner cannot have made both: the same angles at another place, or other angles at the same."""
        if self.place_m is None or other.place_m is None:
            return False
        sent_m = wall_distance_m * math.radians(math.hypot(self.x_deg - other.x_deg, self.y_deg - other.y_deg))
        seen_m = math.dist(self.place_m, other.place_m)
        return (sent_m < SAME_M and seen_m > OTHER_M) or (seen_m < SAME_M and sent_m > OTHER_M)

    def __str__(self) -> str:
        x_m, y_m = self.place_m or (math.nan, math.nan)
        return f"{self.x_deg:+.3f} {self.y_deg:+.3f} deg at {x_m:+.3f} {y_m:+.3f} m"


class Marks:
    """A table that is on the disk after every mark. Written on by its own header where it exists. `count`: its spots;
    `unmeasured`: of those, the ones whose place on the wall is still to be filled in. Raises `InvalidData` for a table
    without the columns of `COLUMNS`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.added = 0
        """How many spots came through `add`."""
        self._look()

    def _look(self) -> None:
        """What is in the table now: between two marks a person may correct it, or put it away."""
        self.count = self.unmeasured = self._lines = 0
        self._marks: list[Mark] = []
        self._header: list[str] = []
        text = self.path.read_text(encoding="utf-8-sig") if self.path.exists() else ""
        self._ends_its_line = not text or text.endswith(("\n", "\r"))
        if text.strip():
            rows = text.splitlines()
            self._lines = len(rows)
            self._header = _header(self.path, rows)
            self.count = sum(bool(row.strip()) for row in rows) - 1
            self._marks, self.unmeasured = _read(rows)

    def add(self, angles: MirrorAngles, measured: tuple[float, float] | None) -> Mark:
        """One spot, at optical angles; `measured` (x_m, y_m), None to be filled in later. Raises `InvalidData` as the
        table does, OSError where it cannot be written."""
        self._look()
        place = ("", "") if measured is None else tuple(f"{each:.5f}" for each in measured)
        x_deg, y_deg = math.degrees(angles.x_rad), math.degrees(angles.y_rad)
        said = dict(zip(COLUMNS, (f"{x_deg:.6f}", f"{y_deg:.6f}", *place), strict=True))
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        begun = bool(self._header)
        if not begun:
            self._header = list(COLUMNS)
            table.writerow(self._header)
            self._lines += 1
        elif not self._ends_its_line:
            text.write("\n")
        table.writerow([said.get(name, "") for name in self._header])
        with self.path.open("a" if begun else "w", encoding="utf-8") as file:
            file.write(text.getvalue())
            file.flush()
            os.fsync(file.fileno())
        self.added += 1
        self.count += 1
        self.unmeasured += measured is None
        self._lines += 1
        self._marks.append(Mark(self._lines, x_deg, y_deg, measured))
        return self._marks[-1]

    def holds(self, angles: MirrorAngles, place_m: tuple[float, float]) -> bool:
        """Whether the table, as it was read before the newest mark, says so: a person may have taken it out."""
        x_deg, y_deg = math.degrees(angles.x_rad), math.degrees(angles.y_rad)
        said = (x_deg, y_deg, *place_m)
        return any(
            each.place_m is not None and math.dist((each.x_deg, each.y_deg, *each.place_m), said) < _WRITTEN
            for each in self._marks
        )

    def contradicted_by(self, new: Mark, wall_distance_m: float) -> list[Mark]:
        """The other marks, of whatever day, that cannot be true together with this one."""
        return [each for each in self._marks if each is not new and each.contradicts(new, wall_distance_m)]


def _header(path: Path, rows: list[str]) -> list[str]:
    """The table's columns, in its order. Raises `InvalidData` where one is missing: nobody could say what a row is."""
    header: list[str] = []
    with suppress(csv.Error):
        header = list(csv.DictReader(rows, skipinitialspace=True).fieldnames or ())
    if missing := [name for name in COLUMNS if header.count(name) != 1]:
        raise InvalidData(
            f"{path}: its header has no column, or two, of {', '.join(missing)}; expected {','.join(COLUMNS)}. "
            "Name another file for the marks, or correct its first line."
        )
    return header


def _read(rows: list[str]) -> tuple[list[Mark], int]:
    """What a table says so far, by its own header, and how many places it lacks; rows that a person has still to
    correct are passed over."""
    marks, unmeasured = list[Mark](), 0
    table = csv.DictReader(rows, skipinitialspace=True)
    with suppress(csv.Error):  # `calibrate --spots` says what is wrong with such a table
        for row in table:
            unmeasured += not (row["x_m"] or "").strip() or not (row["y_m"] or "").strip()
            with suppress(KeyError, TypeError, ValueError):
                x_deg, y_deg, x_m, y_m = (float(row[name]) for name in COLUMNS)
                marks.append(Mark(table.line_num, x_deg, y_deg, (x_m, y_m)))
    return marks, unmeasured
