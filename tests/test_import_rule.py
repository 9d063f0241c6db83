"""Who may import whom: the rule of the house, read from the code itself."""

import ast
from collections.abc import Iterator, Mapping
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
    "usb": (
        *(f"drivers/link/{name}.py" for name in ("usbtmc", "usb_errors", "usb_pipes", "usb_search")),
        "drivers/simulated/usb/",
    ),
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


@pytest.mark.parametrize("room", ["acquisition", "calibration", "recon"])
def test_nothing_above_drivers_knows_the_simulator(room: str) -> None:
    for path in (TOP / room).rglob("*.py"):
        for module in imported_modules(path):
            assert not module.startswith("drivers.simulated"), f"{path.relative_to(TOP)} imports {module}"


def test_no_file_imports_itself_by_way_of_others() -> None:
    """Also where an import is put into a function, or is only there for its types."""
    files = {module_name(path): path for place in (*ROOMS, ABOVE) for path in (TOP / place).rglob("*.py")}
    left = {name: {module for module in nearest(path, files) if module != name} for name, path in files.items()}
    while free := {name for name, modules in left.items() if not modules & left.keys()}:
        left = {name: modules for name, modules in left.items() if name not in free}
    ring = {name: sorted(modules & left.keys()) for name, modules in left.items()}
    assert not ring, f"each of these imports another of them: {ring}"


def module_name(path: Path) -> str:
    """As one imports it, without the leading `nlos.`."""
    parts = path.relative_to(TOP).with_suffix("").parts
    return ".".join(part for part in parts if part not in ("src", "nlos", "__init__"))


def nearest(path: Path, files: Mapping[str, Path]) -> Iterator[str]:
    """The files that a file imports: of a name in one of them, that one."""
    for imported in imported_modules(path):
        module = imported.removeprefix("nlos.")
        while module and module not in files:
            module = module.rpartition(".")[0]
        if module:
            yield module


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_in_their_files(library: str) -> None:
    for room in (*ROOMS, ABOVE):
        for path in (TOP / room).rglob("*.py"):
            name = path.relative_to(TOP).as_posix()
            if any(name == place or (place.endswith("/") and name.startswith(place)) for place in ONLY_IN[library]):
                continue
            for module in imported_modules(path):
                assert module.split(".")[0] != library, f"{name} imports {module}"
