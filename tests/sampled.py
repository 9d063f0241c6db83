"""`@pytest.mark.sampled(every)`: of a test's many cases `make test` runs one in so many, always the same ones, and
`make soak` all of them. A case that is asked for by its name is run."""

import os
from zlib import crc32

import pytest

SOAK = os.environ.get("NLOS_SOAK") == "1"


def leave_to_soak(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Takes the cases out of `items` that are not of the sample."""
    tests: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sampled") is not None:
            item.add_marker(pytest.mark.soak)
            tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    if SOAK:
        return
    left = []
    for cases in tests.values():
        (every,) = cases[0].get_closest_marker("sampled").args  # type: ignore[union-attr]
        # Not every third of them: in a table of cases that would be one of its columns.
        drawn = sorted(cases, key=lambda case: crc32(case.name.encode()))
        left += drawn[-(-len(cases) // every) :]
    named = " ".join(config.args)
    left = [case for case in left if case.name not in named]
    if left:
        config.hook.pytest_deselected(items=left)
        gone = set(left)
        items[:] = [item for item in items if item not in gone]
