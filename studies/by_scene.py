"""A page from rows of many scenes, measured by several processes or machines and put together."""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def run(measured: Callable[[int], Iterable[Row]], scenes: Sequence[int], page: Callable[[list[Row]], str]) -> None:
    """`ROWS.jsonl SCENE ...` measures these and appends their rows; `PAGE.md [ROWS.jsonl ...]` measures those scenes
    that are not in these, and writes the page, in the order of `scenes`."""
    target = Path(sys.argv[1])
    if target.suffix == ".jsonl":
        with target.open("a", encoding="utf-8") as file:
            for scene in map(int, sys.argv[2:]):
                for row in measured(scene):
                    file.write(json.dumps(row) + "\n")
                    file.flush()
        return
    rows = [json.loads(line) for each in sys.argv[2:] for line in Path(each).read_text(encoding="utf-8").splitlines()]
    done = {row["scene"] for row in rows}
    rows += [row for scene in scenes if scene not in done for row in measured(scene)]
    rows.sort(key=lambda row: scenes.index(row["scene"]))
    target.write_text(page(rows), encoding="utf-8")
