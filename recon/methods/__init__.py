"""The catalogue of methods: this folder. One file is one method is one word on the command line.

A method's file has a first docstring line for the catalogue, a `Settings` class, and `build(settings, wall, time)`,
which returns an `nn.Module`: counts (B, 1, T, H, W) and exposure (B, H, W) or None -> `MethodResult(albedo, depth_m,
volume)`, of physics and learned methods alike. `recon/method.py` is the contract.
"""

import ast
import difflib
import importlib
from importlib.util import find_spec
from pathlib import Path
from typing import cast

from pydantic import ValidationError

from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import InvalidSettings
from nlos.recon.method import Method

PLAIN = ("lct", "fk")
"""Methods that need no torch."""


def catalogue() -> dict[str, str]:
    """Every method and its one line, in alphabetical order; imports none of them."""
    files = [file for folder in __path__ for file in Path(folder).glob("[a-z]*.py")]
    return {file.stem: _first_line(file) for file in sorted(files, key=lambda file: file.stem)}


def find(name: str) -> Method:
    """The method of that name. Raises `InvalidSettings` with the nearest name for one that does not exist."""
    known = catalogue()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        raise InvalidSettings(
            f"there is no method '{name}'; " + (f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}")
        )
    if name in PLAIN and not torch_is_installed():
        return cast(Method, importlib.import_module(f"nlos.recon.plain.{name}"))
    return cast(Method, importlib.import_module(f"{__name__}.{name}"))


def torch_is_installed() -> bool:
    """Without it, the methods in `recon/plain` reconstruct all the same."""
    return find_spec("torch") is not None


def parse_settings(name: str, given: dict[str, object]) -> AnySettings:
    """The settings of method `name` with these given. Raises `InvalidSettings` naming key, value and the remedy."""
    method = find(name)
    try:
        return method.Settings.model_validate(given)
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


def _first_line(file: Path) -> str:
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0]
