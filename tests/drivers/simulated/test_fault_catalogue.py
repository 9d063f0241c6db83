"""The table of faults is what the simulators commit, what the tests provoke, and what the page says."""

import re
from pathlib import Path

import pytest

from nlos.drivers.simulated.fault_catalogue import NAMES, TABLES, markdown
from nlos.drivers.simulated.faults import Fault

TOP = Path(__file__).parents[3]
BUILT_IN = {row.name for rows in TABLES.values() for row in rows if row.parameters.startswith("built in")}
NAMED = re.compile(r'"([GABUV]\d{1,2})"')


def named_in(folder: Path, but: str) -> set[str]:
    return {
        name for path in folder.rglob("*.py") if path.name != but for name in NAMED.findall(path.read_text("utf-8"))
    }


def test_the_page_is_made_from_the_table() -> None:
    page = (TOP / "docs" / "faults.md").read_text("utf-8")
    assert page == markdown(), "run: python -m nlos.drivers.simulated.fault_catalogue > docs/faults.md"


def test_every_fault_of_the_table_can_be_committed_and_no_other() -> None:
    named = named_in(TOP / "drivers" / "simulated", "fault_catalogue.py")
    assert named - {"U32"} == NAMES - BUILT_IN  # which is a record format


@pytest.mark.parametrize("name", sorted(NAMES - BUILT_IN))
def test_every_fault_is_provoked_by_a_test(name: str) -> None:
    assert name in named_in(TOP / "tests", "test_fault_catalogue.py")


def test_a_fault_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ValueError, match=r"docs/faults\.md"):
        Fault(name="G11")
