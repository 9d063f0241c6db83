"""The catalogue of methods: this folder, and what installed packages bring. One method is one word on the command line.

A method's file has a first docstring line for the catalogue, a `Settings` class, and `build(settings, wall, time)`,
which returns an `nn.Module`: counts (B, 1, T, H, W) and exposure (B, H, W) or None -> `MethodResult(albedo, depth_m,
volume)`, of physics and learned methods alike. `recon/method.py` is the contract. A word that ends in `.py` is a file
of one's own, in no catalogue (`recon/own_methods.py`).
"""

import ast
import difflib
import importlib
import json
import logging
from importlib.util import find_spec
from pathlib import Path
from typing import cast

from pydantic import ValidationError

from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import InvalidSettings
from nlos.recon.method import Method
from nlos.recon.own_methods import find_in_file, find_in_package, in_a_file, line_of_package, of_packages, settings_of

log = logging.getLogger(__name__)
WEIGHTS_SUFFIX = ".safetensors"
PLAIN = ("lct", "fk")
"""Methods that need no torch."""


def catalogue() -> dict[str, str]:
    """Every method and its one line, in alphabetical order, then those of installed packages; imports none of them."""
    own = {file.stem: first_line(file.read_text(encoding="utf-8")) for file in _files()}
    return own | {name: line_of_package(point) for name, point in of_packages(frozenset(own)).items()}


def usable() -> list[str]:
    """The catalogue without what cannot be loaded, which is said in a warning."""
    found = []
    for name in catalogue():
        try:
            find(name)
        except InvalidSettings as error:
            log.warning("%s. Update or remove the package.", error)
        else:
            found.append(name)
    return found


def find(name: str) -> Method:
    """The method of that name, or in that file where it ends in `.py`.

    Raises `InvalidSettings` with the nearest name for one that does not exist, with file and line for a file that
    holds no method, and where the memory does not hold it; `ModuleNotFoundError` with what to install where it needs
    an extra.
    """
    if in_a_file(name):
        return find_in_file(name)
    own = frozenset(file.stem for file in _files())
    if name not in own and (point := of_packages(own).get(name)) is not None:
        return find_in_package(point)
    if name.endswith(WEIGHTS_SUFFIX):
        raise InvalidSettings(
            f"'{name}' are weights, no method: give them as --weights {name}, in --methods as NAME={name}"
        )
    if name not in own:
        known = catalogue()
        near = difflib.get_close_matches(name.lower(), known, n=1)
        raise InvalidSettings(
            f"there is no method '{name}'; " + (f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}")
        )
    if name in PLAIN and not torch_is_installed():
        return cast(Method, importlib.import_module(f"nlos.recon.without_torch.{name}"))
    try:
        return cast(Method, importlib.import_module(f"{__name__}.{name}"))
    except MemoryError as error:  # no reconstruction that failed: nothing was read, nor measured
        raise InvalidSettings(
            f"{name}: the memory does not hold this method and what it needs. Close what else runs, or reconstruct on "
            "another computer."
        ) from error
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "safetensors"):
            raise
        said = f"{name} needs {error.name}, which is not installed. Install it with: pip install 'nlos[recon]'"
        raise ModuleNotFoundError(said, name=error.name) from error


def torch_is_installed() -> bool:
    """Without it, the methods in `recon/without_torch` reconstruct all the same."""
    return find_spec("torch") is not None


def parse_settings(name: str, given: dict[str, object]) -> AnySettings:
    """The settings of method `name` with these given. Raises `InvalidSettings` naming key, value and the remedy."""
    method = find(name)
    try:
        with settings_of(name, method):
            chosen = method.Settings.model_validate(given)
            in_words(chosen)
            return chosen
    except ValidationError as error:
        known = list(method.Settings.model_fields)
        lines = []
        for problem in error.errors():
            key = ".".join(str(part) for part in problem["loc"])
            if problem["type"] == "extra_forbidden":
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
                lines.append(f"{name} has no setting '{key}'; {hint}")
            else:
                lines.append(f"{name}: {key}: {problem['msg']} (given: {problem['input']!r})")
        raise InvalidSettings("; ".join(lines)) from None


def in_words(settings: AnySettings) -> str:
    """As results keep them: JSON, also of a weights file whose name is no text. Raises what settings of somebody else's
    method may."""
    return json.dumps(settings.model_dump(mode="json"))


def first_line(source: str) -> str:
    """What a method's file says of itself."""
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


def _files() -> list[Path]:
    return sorted((file for folder in __path__ for file in Path(folder).glob("[a-z]*.py")), key=lambda file: file.stem)
