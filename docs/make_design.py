"""Makes docs/design.md, the decisions by room: `python docs/make_design.py`."""

import re
from pathlib import Path

DOCS = Path(__file__).parent
ROOMS = {
    "The house and the command line": [
        (1, 2),
        (110, 110),
        (151, 151),
        (180, 180),
        (236, 236),
        (260, 271),
        (283, 286),
        (349, 349),
    ],
    "Drivers": [(10, 34), (111, 116), (140, 149), (152, 154), (210, 211), (221, 221), (230, 234)],
    "Acquisition": [
        (40, 46),
        (117, 139),
        (159, 159),
        (195, 195),
        (198, 198),
        (225, 229),
        (247, 247),
        (300, 304),
        (315, 315),
    ],
    "Calibration": [(50, 59), (197, 197), (255, 255)],
    "At the bench: first light, aiming by hand, the doctor": [
        (156, 157),
        (190, 194),
        (196, 196),
        (240, 244),
        (275, 279),
    ],
    "Physics reconstruction": [(60, 69), (150, 150), (158, 158), (184, 184)],
    "Learned reconstruction": [(70, 89), (100, 109), (160, 179), (181, 183), (185, 189), (200, 204), (220, 220)],
    "What a picture explains, and how sure it is": [
        (205, 209),
        (235, 235),
        (245, 246),
        (280, 280),
        (311, 311),
    ],
    "Watching a scan": [(90, 99), (272, 274), (330, 330), (350, 350)],
    "Scenes that move": [(215, 219), (250, 254), (256, 256), (281, 282)],
}
TOP = """# Design

Data moves through the rooms from left to right. A room imports only those to its left, which a test enforces.

```
configs/   drivers/     acquisition/    calibration/       recon/
YAML    -> bytes <-> -> plan, scan,  -> raw counts ->   -> transient
files      devices      record,         counts for         -> what is
                        replay          the physics        hidden

     nlos   the API and the command line: the only room that knows
            all the others
```

| you look for | it is in |
|---|---|
| bytes to and from an instrument | `drivers/galvo/<model>/wire.py`, `drivers/tcspc/<model>/` |
| the other end of the cable | `drivers/simulated/<model>/`; what can go wrong there: [Faults](faults.md) |
| which points, in which order, for how long | `acquisition/planning/` |
| which scheme a scan is taken by, and how long that takes | `acquisition/planning/schemes.py` |
| the scan itself, its schemes and alarms | `acquisition/scanning/` |
| the file, and how it survives everything | `acquisition/recording/`; what it may say: `validation.py` there |
| a trip that outlasts the program | `drivers/trip_latch.py` |
| a new counter or mirror | a folder in `drivers/tcspc/` or `galvo/`, a line in `known_*.py` there; or a plug-in |
| dead time, time zero, direct light | `calibration/`, a file each; their order: `correct.py` there |
| an operator of light transport | `recon/transport/`; a method: `recon/methods/` |
| what counts as seen in a picture | `recon/seen.py` |
| what a verb does | `src/nlos/cli/<verb>.py` |
| what the live page shows, and its controls | `src/nlos/live/page_parts/` |
| what the wheel holds | `pyproject.toml`; the sdist: `MANIFEST.in` |

## Decisions

What was decided, why, and what was measured, ten lines each.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [TOP]
    known = {int(path.name[:3]): path for path in sorted((DOCS / "decisions").glob("[0-9]*.md"))}
    placed = set()
    for room, spans in ROOMS.items():
        chosen = [number for number in known if any(low <= number <= high for low, high in spans)]
        placed.update(chosen)
        parts.append(f"### {room}\n")
        parts += [_line(number, known[number]) for number in sorted(chosen)]
        parts.append("")
    if left := sorted(set(known) - placed):
        parts += ["### Everything else\n", *(_line(number, known[number]) for number in left), ""]
    return "\n".join(parts)


def _line(number: int, path: Path) -> str:
    title = path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ").replace("`", "")
    return f"- [{number:03d}](decisions/{path.name}) {re.sub(r'^[0-9]+[.:]? ', '', title)}"


if __name__ == "__main__":
    (DOCS / "design.md").write_text(page(), encoding="utf-8")
