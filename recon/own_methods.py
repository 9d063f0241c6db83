"""Methods that do not come with this package: a Python file, or the entry point `nlos.methods` of an installed one.

Nothing is looked for in any folder: a file is run because it was named, a package's method because it was asked for.
What is wrong with either is said with its file and line.
"""

import ast
import hashlib
import importlib.util
import inspect
import logging
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import NO_PICTURE, InvalidSettings, ReconstructionFailed
from nlos.recon.method import Method

GROUP = "nlos.methods"
_log = logging.getLogger(__name__)


def in_a_file(word: str) -> bool:
    """Whether `word` is the file of a method, and not its name."""
    return word.endswith(".py")


def name_of(word: str) -> str:
    """What a method is called in results: its name, of a file the file's own."""
    return Path(word).name if in_a_file(word) else word


def find_in_file(word: str) -> Method:
    """The method in the file `word`, run once for each state of the file. Raises `InvalidSettings`."""
    try:
        path = Path(word).expanduser().resolve()
        text = path.read_bytes()
    except (OSError, RuntimeError) as error:  # RuntimeError: the `~` of somebody who has no home
        raise InvalidSettings(f"the method {word} cannot be read: {getattr(error, 'strerror', error)}") from error
    return cast(Method, _run(path, hashlib.sha256(text).hexdigest()))


def of_packages(own: frozenset[str]) -> dict[str, EntryPoint]:
    """Word -> entry point of every installed package's methods. One that has the name of another is skipped, said in
    a warning."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda each: (each.name, each.value)):
        if point.name in own or point.name in found or in_a_file(point.name):
            _say_skipped(point.name, _package(point))
        else:
            found[point.name] = point
    return found


@cache
def _say_skipped(name: str, package: str) -> None:
    """Once: a command asks for the methods several times."""
    _log.warning("the method %s of %s is skipped: the name is taken", name, package)


def line_of_package(point: EntryPoint) -> str:
    """For the catalogue, without importing it: what the package says of itself."""
    said = point.dist.metadata.json.get("summary") if point.dist else None
    return f"{said or 'A method of one’s own'} (package {_package(point)})"


def find_in_package(point: EntryPoint) -> Method:
    """The method behind an entry point. Raises `InvalidSettings` where it is none."""
    whose = f"the method {point.name} of the package {_package(point)}"
    with _refused(whose, ""):
        found = point.load()
    _check(found, whose)
    return cast(Method, found)


@contextmanager
def with_its_line(method: str, found: Method) -> Iterator[None]:
    """What a method of one's own raises becomes `ReconstructionFailed` with its file and line."""
    file = str(getattr(found, "__file__", ""))
    if _ours(found):
        yield
        return
    try:
        yield
    except (Exception, SystemExit) as error:  # it may raise anything; to its author, file and line say more than a bug
        if isinstance(error, NO_PICTURE) or _is_extra(error) or _is_told(error, file):
            raise
        raise ReconstructionFailed(
            f"{_place(error, file) or method}: {type(error).__name__}: {error}. The method raised this, the scan is "
            "as it was."
        ) from error


def _is_told(error: BaseException, file: str) -> bool:
    """Whether it is a signal that ends the program, and not a `sys.exit()` of the method's own."""
    return isinstance(error, SystemExit) and traceback.extract_tb(error.__traceback__)[-1].filename != file


def defined_at(found: object, name: str) -> str:
    """`file:line: ` of the class or function `name` of a method; empty for methods that come with this package."""
    file = getattr(found, "__file__", None)
    if file is None or _ours(found):
        return ""
    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return f"{file}:{node.lineno}: "
    return f"{file}:1: "


def _ours(found: object) -> bool:
    return getattr(found, "__name__", "").startswith("nlos.recon.")


@cache
def _run(path: Path, sha256: str) -> ModuleType:
    name = f"nlos_method_{path.stem}_{sha256[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where pydantic and inspect look a class's module up
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # its own helpers beside it; last, so that none hides an installed package
    try:
        with _refused(str(path), str(path)):
            spec.loader.exec_module(module)
        _check(module, str(path))
        if not (module.__doc__ or "").strip():
            raise InvalidSettings(
                f'{path}:1: the file does not say what it is: begin it with a line like """What it sees by."""'
            )
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _refused(whose: str, file: str) -> Iterator[None]:
    """What running a file raises, as `InvalidSettings` with the line; a missing extra stays what it is."""
    try:
        yield
    except SyntaxError as error:
        raise InvalidSettings(f"{error.filename or whose}:{error.lineno}: {error.msg}") from error
    except (Exception, SystemExit) as error:  # importing it runs it, and it may raise anything, or try to end
        if _is_extra(error):
            raise
        said = str(error).split("\n\nFor further information", 1)[0]  # pydantic's, with a web address
        raise InvalidSettings(f"{_place(error, file) or whose}: {type(error).__name__}: {said}") from error


def _is_extra(error: BaseException) -> bool:
    """Whether what is missing is a part of this package's own that can be installed."""
    return isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in ("torch", "safetensors")


def _check(found: Any, whose: str) -> None:
    """Raises `InvalidSettings` for what lacks a part of the contract in `recon/method.py`."""
    settings, build = getattr(found, "Settings", None), getattr(found, "build", None)
    missing = [what for what, value in (("class Settings", settings), ("function build", build)) if value is None]
    if missing:
        raise InvalidSettings(
            f"{whose}: no method in it: there is no {' and no '.join(missing)} (nlos.recon.method is the contract)"
        )
    if not (isinstance(settings, type) and issubclass(settings, AnySettings)):
        where = defined_at(found, "Settings") or f"{whose}: "
        raise InvalidSettings(f"{where}Settings must derive from nlos.configs.settings.Settings")
    if not callable(build) or not _takes_three(build):
        where = defined_at(found, "build") or f"{whose}: "
        raise InvalidSettings(f"{where}build must be a function of (settings, wall, time)")


def _takes_three(build: Callable[..., object]) -> bool:
    try:
        inspect.signature(build).bind("settings", "wall", "time")
    except (TypeError, ValueError):
        return False
    return True


def _place(error: BaseException, file: str) -> str:
    """`file:line` of the last line of `file` that took part in an error; of any file where it took none."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == file] or frames[-1:]
    return f"{own[-1].filename}:{own[-1].lineno}" if own else ""


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "an unnamed package"
