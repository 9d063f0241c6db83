"""Rules of the house that no linter checks: attributes are born in `__init__`, broad excepts have a reason, nothing of
our own is pickled, and functions take few values."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

TOP = Path(__file__).parents[1]
PLACES = ("configs", "drivers", "acquisition", "calibration", "recon", "src/nlos", "studies")
MAKERS = ("__init__", "__post_init__")
FROM_OUTSIDE = {("SimulatedSerial", "is_open"): "pyserial's SerialBase makes it"}
BROAD = {
    "drivers/closing.py": "whatever fails on the way out, the light is tried again and every later step is done",
    "drivers/plug_in_device.py": "somebody else's driver may raise anything; whatever it is becomes a device error",
    "drivers/plug_ins.py": "importing somebody else's package runs it; the other benches go on as ever",
    "drivers/wire_log.py": "whatever fails in keeping bytes must not hold up the command that shuts the light",
    "acquisition/scanning/advice.py": "what fails in somebody else's adviser ends no scan, and is said in its log",
    "recon/own_methods.py": "a method of somebody else may raise anything; its file and line are told",
    "src/nlos/cli/archive_task.py": "one file's bug, told with its traceback, must not cost a night's other files",
}

MOST_PARAMETERS = 6
MORE = {
    "src/nlos/acquiring.py": {"scan"},
    "src/nlos/reconstructing.py": {"reconstruct"},
    "src/nlos/scan_data.py": {"load"},
    "src/nlos/array_scan.py": {"scan_from_arrays"},
    "acquisition/scanning/engine.py": {"scan"},
    "drivers/bench.py": {"__init__"},
    "drivers/link/serial_line.py": {"open"},
    "drivers/simulated/timetagger/flim.py": {"__init__"},
    "drivers/simulated/usb/backend.py": {"ctrl_transfer"},
    "drivers/simulated/usb/pipes.py": {"ctrl_transfer"},
    "recon/evaluate.py": {"evaluate"},
}
"""Doors whose parameters are options by name, signatures of others' (pyusb, Time Tagger), a bench's parts and a port's
settings; beside the verbs, whose parameters are the command line's options."""


def files() -> Iterator[tuple[str, ast.Module]]:
    for place in PLACES:
        for path in sorted((TOP / place).rglob("*.py")):
            yield path.relative_to(TOP).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


@cache
def classes() -> dict[str, list[tuple[str, ast.ClassDef]]]:
    """By name; of two classes of one name both count as bases, which can only let something pass."""
    found: dict[str, list[tuple[str, ast.ClassDef]]] = {}
    for name, tree in files():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append((name, node))
    return found


def family(node: ast.ClassDef) -> list[ast.ClassDef]:
    """The class and its bases, as far as they are ours."""
    kin = [node]
    for one in kin:
        bases = [each.value if isinstance(each, ast.Subscript) else each for each in one.bases]
        names = [each.attr if isinstance(each, ast.Attribute) else getattr(each, "id", "") for each in bases]
        kin += [base for name in names for _, base in classes().get(name, []) if base not in kin]
    return kin


def methods(node: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    return (each for each in node.body if isinstance(each, ast.FunctionDef))


def own(node: ast.AST, store: bool) -> Iterator[tuple[str, int]]:
    """Names X of every `self.X` that is assigned, or read."""
    for each in ast.walk(node):
        if not (isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name) and each.value.id == "self"):
            continue
        if isinstance(each.ctx, ast.Store) is store:
            yield each.attr, each.lineno


def born(node: ast.ClassDef) -> set[str]:
    """What is there once the object is made: in the class, in `__init__`, or in methods that `__init__` calls."""
    kin = family(node)
    names = {name.id for each in kin for line in each.body if isinstance(line, (ast.Assign, ast.AnnAssign))
             for name in ast.walk(line) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}  # fmt: skip
    waiting, seen = set(MAKERS), set[str]()
    while waiting:
        now = waiting.pop()
        seen.add(now)
        for method in (each for one in kin for each in methods(one) if each.name == now):
            names |= {name for name, _ in own(method, store=True)}
            called = {name for call in ast.walk(method) if isinstance(call, ast.Call)
                      for name, _ in own(call.func, store=False)}  # fmt: skip
            waiting |= called - seen
    return names


def test_attributes_are_born_in_init() -> None:
    late = [
        f"{file}:{line}: {node.name}.{name} in {method.name}"
        for same in classes().values()
        for file, node in same
        for there in [born(node)]
        for method in methods(node)
        for name, line in own(method, store=True)
        if name not in there and (node.name, name) not in FROM_OUTSIDE
    ]
    assert not late, "give them a first value in __init__:\n" + "\n".join(late)


def test_everything_is_caught_only_where_that_has_a_reason() -> None:
    found = {
        file
        for file, tree in files()
        for node in ast.walk(tree)
        if isinstance(node, ast.ExceptHandler)
        if node.type is None
        or any(isinstance(kind, ast.Name) and kind.id == "Exception" for kind in ast.walk(node.type))
    }
    assert found == BROAD.keys()


def test_what_a_user_is_told_names_no_page_that_only_the_repository_has() -> None:
    """Messages, and the lines below settings: whoever installed a wheel has no `docs`."""
    told = [f"{path.name}" for path in (TOP / "configs/bench").glob("*.yaml") if "docs/" in path.read_text("utf-8")]
    for file, tree in files():
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
        for_readers = {
            id(getattr(node.body[0], "value", None)) for node in ast.walk(tree) if isinstance(node, kinds) and node.body
        }
        told += [
            f"{file}:{node.lineno}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and "docs/" in node.value
            if id(node) not in for_readers and not file.startswith("studies")
        ]
    assert not told


def test_only_weights_from_outside_are_unpickled() -> None:
    found = {
        file
        for file, tree in files()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        if isinstance(node.value, ast.Name) and (node.value.id, node.attr) in {("torch", "save"), ("torch", "load")}
    }
    assert found == {"recon/weights/foreign.py"}


def test_functions_take_few_parameters() -> None:
    many: dict[str, set[str]] = {}
    for file, tree in files():
        verb = Path(file).stem.rstrip("_") if file.startswith("src/nlos/cli/") else ""
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name.rstrip("_") != verb:
                asked = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                if len([each for each in asked if each.arg not in ("self", "cls")]) > MOST_PARAMETERS:
                    many.setdefault(file, set()).add(node.name)
    assert many == MORE, "values that belong together are one value; what is short again leaves the list"
