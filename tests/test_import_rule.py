"""Who may import whom: the rule of the house, read from the code itself."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]
ROOMS = {
    "configs": set(),
    "drivers": {"configs.settings"},
    "acquisition": {"configs.settings", "drivers"},
    "calibration": {"configs.settings", "acquisition"},
    "recon": {"configs.settings", "acquisition"},
}
ONLY_IN = {
    "serial": ("drivers/link/serial_line.py", "drivers/simulated/serial/port.py"),
    "usb": ("drivers/link/usbtmc.py", "drivers/simulated/usb/backend.py"),
    "torch": ("recon/",),
    "h5py": (
        "acquisition/recording/",
        "acquisition/importers/",
        "acquisition/exporters/",
        "calibration/constants.py",
        "recon/results.py",
        "recon/evaluate.py",
        "recon/training/",
    ),
}


ABOVE = "src/nlos"  # the API and the command line: beside the rooms' links, which `rglob` does not follow


def imported_modules(path: Path) -> Iterator[str]:
    """Modules that a file imports; our own without the leading `nlos.` where they belong to a room."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide which room they reach"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            room = name.removeprefix("nlos.").split(".")[0]
            yield name.removeprefix("nlos.") if room in ROOMS else name


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_what_lies_before_them(room: str) -> None:
    others = (set(ROOMS) | {"nlos", "studies"}) - {room}
    for path in (TOP / room).rglob("*.py"):
        for module in imported_modules(path):
            if module.split(".")[0] not in others:
                continue
            allowed = any(module == rule or module.startswith(rule + ".") for rule in ROOMS[room])
            assert allowed, f"{path.relative_to(TOP)} imports {module}"


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_in_their_files(library: str) -> None:
    for room in (*ROOMS, ABOVE):
        for path in (TOP / room).rglob("*.py"):
            name = path.relative_to(TOP).as_posix()
            if any(name == place or (place.endswith("/") and name.startswith(place)) for place in ONLY_IN[library]):
                continue
            for module in imported_modules(path):
                assert module.split(".")[0] != library, f"{name} imports {module}"
