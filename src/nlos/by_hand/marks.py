"""Spots on the wall, as `nlos calibrate --spots` reads them: commanded angles, and where a ruler found the beam."""

import csv
import io
import math
import os
from pathlib import Path

from nlos.drivers.galvo.mirror import MirrorAngles

COLUMNS = ("x_deg", "y_deg", "x_m", "y_m")


class Marks:
    """A table that is on the disk after every mark. Written on where it exists. `count`: its spots; `unmeasured`: of
    those, the ones whose place on the wall is still to be filled in."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = self.unmeasured = 0
        if path.exists():
            rows = path.read_text(encoding="utf-8-sig").splitlines()[1:]
            self.count = len(rows)
            self.unmeasured = sum(row.rstrip().endswith(",") for row in rows)

    def add(self, angles: MirrorAngles, measured: tuple[float, float] | None) -> None:
        """One spot, at optical angles; `measured` (x_m, y_m), None to be filled in later."""
        place = ("", "") if measured is None else tuple(f"{each:.5f}" for each in measured)
        row = (f"{math.degrees(angles.x_rad):.6f}", f"{math.degrees(angles.y_rad):.6f}", *place)
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        if not self.path.exists():
            table.writerow(COLUMNS)
        table.writerow(row)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(text.getvalue())
            file.flush()
            os.fsync(file.fileno())
        self.count += 1
        self.unmeasured += measured is None
