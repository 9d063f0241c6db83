"""Methods that do not come with this package: a Python file, or the entry point `nlos.methods` of an installed one.

Nothing is looked for in any folder: a file is run because it was named, a package's method because it was asked for.
What is wrong with either is said with its file and line.
"""

import ast
import faulthandler
import hashlib
import importlib.util
import inspect
import logging
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from pydantic import ValidationError

from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import NO_PICTURE, InvalidSettings, ReconstructionFailed
from nlos.recon.method import Method
from nlos.recon.put_back import put_back

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
        if in_a_file(point.name):
            _say_skipped(point.name, _package(point), "a name that ends in .py is a file's")
        elif point.name in own or point.name in found:
            _say_skipped(point.name, _package(point), "the name is taken")
        else:
            found[point.name] = point
    return found


@cache
def _say_skipped(name: str, package: str, why: str) -> None:
    """Once: a command asks for the methods several times."""
    _log.warning("the method %s of %s is skipped: %s", name, package, why)


def line_of_package(point: EntryPoint) -> str:
    """For the catalogue, without importing it: what the package says of itself."""
    said = point.dist.metadata.json.get("summary") if point.dist else None
    return f"{said or 'A method of one’s own'} (package {_package(point)})"


def find_in_package(point: EntryPoint) -> Method:
    """The method behind an entry point. Raises `InvalidSettings` where it is none."""
    whose = f"the method {point.name} of the package {_package(point)}"
    with _refused(whose, point.module):
        found = point.load()
    _check(found, whose)
    return cast(Method, found)


@contextmanager
def with_its_line(method: str, found: Method) -> Iterator[None]:
    """What a method of one's own raises becomes `ReconstructionFailed` with its file and line, and what it changes of
    the whole program is put back."""
    if _ours(found):
        yield
        return
    try:
        with _crashes_told(), put_back(f"the method {method}"):
            yield
    except BaseException as error:  # it may raise anything; to its author, file and line say more than a bug
        if isinstance(error, NO_PICTURE) or _is_extra(error) or _is_told(error):
            raise
        where = _where(error, found) or method
        raise ReconstructionFailed(
            f"{where}: {said_of(error)}. The method {method} raised this, the scan is as it was."
        ) from error


@contextmanager
def _crashes_told() -> Iterator[None]:
    """A crash of a method's library in C ends the process: its last words tell the method's own file and line."""
    told = faulthandler.is_enabled()
    with suppress(AttributeError, OSError, ValueError, RuntimeError):  # nothing is printed where nobody would see it
        if not told:
            faulthandler.enable()
    try:
        yield
    finally:
        if not told:
            faulthandler.disable()


@contextmanager
def settings_of(method: str, found: Method) -> Iterator[None]:
    """What the settings of a method of one's own raise, but for values that they refuse, as `InvalidSettings`."""
    if _ours(found):
        yield
        return
    try:
        with put_back(f"the method {method}"):
            yield
    except BaseException as error:
        if isinstance(error, ValidationError | InvalidSettings) or _is_told(error):
            raise
        where = _where(error, found) or defined_at(found, "Settings").removesuffix(": ")
        raise InvalidSettings(f"{where}: {said_of(error)}. The settings of the method {method} raised this.") from error


def said_of(error: BaseException) -> str:
    """Its kind, and what it says, if anything: both are somebody else's."""
    try:
        said = str(error)
    except Exception:  # what it makes of itself may fail, too
        said = ""
    return f"{type(error).__name__}: {said}".removesuffix(": ")


def _is_told(error: BaseException) -> bool:
    """Whether the command is told to end, by a signal or because nobody waits any more, and not by the method itself,
    which may call `sys.exit()` or raise what is no `Exception`."""
    if isinstance(error, Exception):
        return False
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    raised_in = "" if last is None else str(last.tb_frame.f_globals.get("__name__", ""))
    return isinstance(error, KeyboardInterrupt) or raised_in.startswith("nlos.")


def defined_at(found: object, name: str) -> str:
    """`file:line: ` of the class or function `name` of a method; empty for methods that come with this package."""
    file = getattr(found, "__file__", None)
    if file is None or _ours(found):
        return ""
    try:
        tree = ast.parse(Path(file).read_bytes())
    except (OSError, SyntaxError, ValueError):  # it is compiled, or is no longer what was run
        return f"{file}: "
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
        with _refused(str(path), name):
            spec.loader.exec_module(module)
        _check(module, str(path))
        if not (ast.get_docstring(ast.parse(path.read_bytes())) or "").strip():  # `python -OO` keeps no __doc__
            raise InvalidSettings(
                f'{path}:1: the file does not say what it is: begin it with a line like """What it sees by."""'
            )
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _refused(whose: str, module: str) -> Iterator[None]:
    """What running a module raises, as `InvalidSettings` with its line; a missing extra stays what it is."""
    try:
        with put_back(whose):
            yield
    except SyntaxError as error:
        raise InvalidSettings(f"{error.filename or whose}:{error.lineno}: {error.msg}") from error
    except BaseException as error:  # importing it runs it, and it may raise anything, or try to end
        if _is_extra(error) or _is_told(error):
            raise
        said = said_of(error).split("\n\nFor further information", 1)[0]  # pydantic's, with a web address
        raise InvalidSettings(f"{_place(error, module) or whose}: {said}") from error


def _is_extra(error: BaseException) -> bool:
    """Whether what is missing is a part of this package's own that can be installed."""
    return isinstance(error, ModuleNotFoundError) and error.name in ("torch", "safetensors")


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


def _place(error: BaseException, module: str, file: str = "") -> str:
    """`file:line` of the last line of a module, of its package, or of what lies beside its `file`, that took part in an
    error; empty where none did."""
    own = [
        f"{frame.f_code.co_filename}:{line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] == module.partition(".")[0]
        or (file and Path(frame.f_code.co_filename).parent == Path(file).parent)
    ]
    return own[-1] if own else ""


def _where(error: BaseException, found: object) -> str:
    """The same of a method that was found."""
    return _place(error, str(getattr(found, "__name__", "")), str(getattr(found, "__file__", "")))


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "an unnamed package"
