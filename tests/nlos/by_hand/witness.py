"""What the simulated table itself says of light and beam: the account that a use by hand is held against."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from nlos.configs.load import find


def bench_file(folder: Path, changes: dict[str, dict[str, object]] | None = None, name: str = "simulated") -> Path:
    """A shipped bench, dim and coarse so that its photons cost little, whose table writes `witness.txt`."""
    document = yaml.safe_load(find("bench", name).read_text("utf-8"))
    document["simulation"]["witness"] = str(folder / "witness.txt")
    document["simulation"]["scene"]["surfel_m"] = 0.1
    for key, block in (changes or {}).items():
        document[key] = {**document.get(key, {}), **block}
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return path


STARVED_S = 0.0 if os.environ.get("NLOS_SOAK") == "1" else 0.5
"""How late the light may be shut on a machine that is busy with other tests; a campaign has it to itself."""


@dataclass
class Account:
    """`lit`: from when to when there was light, on the table's clock; an end of None: the account ends in the light.
    `lit_beams`: angles (x_rad, y_rad) at which the beam was in the light. `watchdog_s`: as it was when light began."""

    lit: list[tuple[float, float | None]] = field(default_factory=list)
    lit_beams: list[tuple[float, float]] = field(default_factory=list)
    beams: list[tuple[float, float]] = field(default_factory=list)
    watchdogs_s: list[float] = field(default_factory=list)

    @property
    def lit_s(self) -> float:
        """How long there was light that ended."""
        return sum(end - start for start, end in self.lit if end is not None)

    @property
    def ends_dark(self) -> bool:
        return not self.lit or self.lit[-1][1] is not None


def account(folder: Path) -> Account:
    found, beam, watchdog_s, is_open = Account(), (0.0, 0.0), 0.0, False
    path = folder / "witness.txt"
    for line in path.read_text().splitlines() if path.exists() else []:
        when, _, what = line.partition(" ")
        if what.startswith("beam to"):
            x, y = what.split()[2:]
            beam = float(x), float(y)
            found.beams.append(beam)
            if is_open:
                found.lit_beams.append(beam)
        elif what.startswith("watchdog"):
            watchdog_s = float(what.split()[1])
        elif what == "shutter open" and not is_open:
            is_open = True
            found.lit.append((float(when), None))
            found.lit_beams.append(beam)
            found.watchdogs_s.append(watchdog_s)
        elif what == "shutter closed" and is_open:
            is_open = False
            found.lit[-1] = (found.lit[-1][0], float(when))
    return found
