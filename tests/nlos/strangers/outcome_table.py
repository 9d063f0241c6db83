"""The table of what comes of damaged files, kind by kind and verb by verb: made from the reports of a whole campaign.

`NLOS_SOAK=1 NLOS_MUTATED_REPORT=DIR/part python -m pytest -m soak tests/nlos/strangers/test_mutated_files.py`, then
`python -m tests.nlos.strangers.outcome_table DIR/part.*.json > docs/damaged-files.md`.
"""

import json
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

TABLE = Path(__file__).parents[3] / "docs" / "damaged-files.md"
CODES = {0: "read", 2: "2 settings", 4: "4 limits", 6: "6 storage", 7: "7 data", 8: "8 reconstruction"}
HEAD = """\
# Damaged files

What comes of files damaged at random: bytes flipped, words set to extremes, the end cut off, a part repeated, moved or
zeroed. {total:,} cases, each a file of one kind given to one verb that reads it. No case ends with exit code 1, a
crash, a hang, or a descriptor, thread or process left behind; a refusal names the file; and where `verify` says that a
recording is whole, or `recover` and `replay` make a copy, every sample in it is the one that was measured, at its
place.

"Read": exit code 0. The damage is where the verb does not look, or rows with damage are set aside and counted, or the
file (text, tables of numbers without a checksum) means something else now; a damaged index of runs is made anew, and
`runs` says what the recordings do. The other columns are exit codes. Where a column holds every case, the verb refuses
undamaged files of that kind, too: `verify` of what is no recording, `calibrate` of a curve without a wall.

*This page is made by `python -m tests.nlos.strangers.outcome_table` from the reports of the campaign
([campaigns](campaigns.md)); a test holds its sample against it.*
"""
_ROW = "| {kind} | `{verb}` | {codes} |"


def read_table(text: str) -> dict[tuple[str, str], dict[int, int]]:
    """Kind and verb -> exit code -> how many cases."""
    found: dict[tuple[str, str], dict[int, int]] = defaultdict(dict)
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == len(CODES) + 2 and cells[1].startswith("`"):
            counts = zip(CODES, cells[2:], strict=True)
            found[cells[0], cells[1].strip("`")] = {code: int(cell) for code, cell in counts if cell}
    return found


def page(rows: Iterable[tuple[str, str, int, int]]) -> str:
    """The page for (kind, verb, exit code, cases)."""
    counts: dict[tuple[str, str], Counter[int]] = defaultdict(Counter)
    for kind, verb, code, number in rows:
        counts[kind, verb][code] += number
    lines = [f"| kind of file | verb | {' | '.join(CODES.values())} |", "|---|---|" + "---:|" * len(CODES)]
    for (kind, verb), each in counts.items():
        lines.append(_ROW.format(kind=kind, verb=verb, codes=" | ".join(str(each[code] or "") for code in CODES)))
    return HEAD.format(total=sum(each.total() for each in counts.values())) + "\n" + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(tuple(row) for path in sys.argv[1:] for row in json.loads(Path(path).read_text())), end="")
