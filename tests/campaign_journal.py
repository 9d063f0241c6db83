"""A campaign that was cut off is resumed: with NLOS_SOAK_JOURNAL=FILE each test's outcome is a line of that file, and
what has passed by it is not run again. `python -m tests.campaign_journal FILE` counts the outcomes."""

import json
import os
import sys
from collections import Counter
from pathlib import Path

import pytest

JOURNAL = os.environ.get("NLOS_SOAK_JOURNAL")


def lines(path: Path) -> list[tuple[str, str, float]]:
    """Each test's last outcome."""
    if not path.exists():
        return []
    return list({row[0]: tuple(row) for row in map(json.loads, path.read_text().splitlines())}.values())


def deselect_what_has_passed(config: pytest.Config, items: list[pytest.Item]) -> None:
    if JOURNAL is None:
        return
    passed = {node for node, outcome, _ in lines(Path(JOURNAL)) if outcome == "passed"}
    done = [item for item in items if item.nodeid in passed]
    if done:
        config.hook.pytest_deselected(items=done)
        items[:] = [item for item in items if item.nodeid not in passed]


def write(report: pytest.TestReport) -> None:
    """In the process that reports, not in one of several that run: a failure of a fixture is a failure."""
    if JOURNAL is None or "PYTEST_XDIST_WORKER" in os.environ:
        return
    if report.when == "call" or report.outcome != "passed":
        with Path(JOURNAL).open("a") as file:
            file.write(json.dumps([report.nodeid, report.outcome, round(report.duration, 3)]) + "\n")


def main() -> None:
    """Prints, for each test function, how many cases ended how, and how long they took."""
    counts: Counter[tuple[str, str]] = Counter()
    seconds: Counter[str] = Counter()
    for node, outcome, took_s in lines(Path(sys.argv[1])):
        name = node.partition("[")[0]
        counts[name, outcome] += 1
        seconds[name] += took_s
    for (name, outcome), number in sorted(counts.items()):
        print(f"{name}: {number} {outcome}, {seconds[name]:.0f} s in all")


if __name__ == "__main__":
    main()
