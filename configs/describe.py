"""What a block of settings may hold: every key with its type, unit, default and meaning, read from its class.

The meaning of a key is the string below it in the class, or the part of the class's docstring that names it.
"""

import ast
import inspect
import re
import textwrap
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

UNITS = {
    "_m": "m", "_mm": "mm", "_s": "s", "_ms": "ms", "_us": "us", "_ns": "ns", "_ps": "ps", "_hz": "Hz", "_khz": "kHz",
    "_mhz": "MHz", "_cps": "counts/s", "_deg": "deg", "_rad": "rad", "_mv": "mV", "_v": "V",
    "_bytes": "bytes", "_mb": "MB", "_megabytes_per_s": "MB/s",
}  # fmt: skip


KIND = "kind"
"""The key that tells blocks apart of which a file names one: its word has to be written, though the class knows it."""


@dataclass(frozen=True)
class Setting:
    """One key."""

    name: str
    type: str
    unit: str
    """Empty where the number is plain, or the key is no number."""
    default: str
    """As YAML writes it; empty where the key must be given."""
    range: str
    what: str

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        default = f", default {self.default}{unit if self.default not in ('none', '') else ''}" if self.default else ""
        bounds = f" {self.range}" if self.range else ""
        return f"{self.name}: {self.type}{unit}{bounds}{default}. {self.what}".strip()


def describe(model: type[BaseModel]) -> dict[str, Setting]:
    """Every key of `model`, in the order of the class."""
    meanings = _meanings(model)
    found = {}
    for name, field in model.model_fields.items():
        key = field.alias or name
        meaning = meanings.get(name) or meanings.get(key, "")
        if key == KIND:
            found[key] = Setting(key, _type(field.annotation), "", "", "", "The word that chooses this block.")
            continue
        found[key] = Setting(key, _type(field.annotation), _unit(key), _default(field), _range(field), meaning)
    return found


def _unit(name: str) -> str:
    return next((unit for end, unit in sorted(UNITS.items(), key=lambda e: -len(e[0])) if name.endswith(end)), "")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        return "{" + ", ".join(f"{k}: {_yaml(v)}" for k, v in value.model_dump(mode="json").items()) + "}"
    return _yaml(value)


def _yaml(value: Any) -> str:
    if value is None:
        return "none"
    if value == "":
        return '""'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_yaml(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _range(field: FieldInfo) -> str:
    """Bounds as an interval, from whatever pydantic holds of them."""
    found = [*field.metadata, *_metadata(field.annotation)]
    low = next((f"({m.gt:g}" if isinstance(m, Gt) else f"[{m.ge:g}" for m in found if isinstance(m, Gt | Ge)), "")
    high = next((f"{m.lt:g})" if isinstance(m, Lt) else f"{m.le:g}]" for m in found if isinstance(m, Lt | Le)), "")
    if not low and not high:
        return ""
    return f"{low or '(-inf'}, {high or 'inf)'}"


def _metadata(annotation: Any) -> list[Any]:
    """Constraints inside `X | None` and `Annotated`."""
    found: list[Any] = []
    for part in (annotation, *get_args(annotation)):
        for constraint in getattr(part, "__metadata__", ()):
            found += constraint.metadata if isinstance(constraint, FieldInfo) else [constraint]
    return found


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(_yaml(a) for a in arguments)
    if hasattr(annotation, "__metadata__"):
        return _type(arguments[0])
    if origin is Union or type(annotation).__name__ == "UnionType":
        return " or ".join(_type(a) for a in arguments if a is not type(None))
    if origin in (tuple, list):
        return f"list of {_type(arguments[0])}" if arguments else "list"
    if origin is dict:
        return "mapping"
    names = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"{annotation.__name__.removesuffix('Settings')} block"
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))


@cache
def _meanings(model: type[BaseModel]) -> dict[str, str]:
    """Key -> the string below it, the nearest class first; else what the class's docstring says of it."""
    found: dict[str, str] = {}
    for kind in model.__mro__:
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)) or kind is BaseModel:
            continue
        for name, text in _strings_below(kind).items():
            found.setdefault(name, text)
        for name, text in re.findall(r"`(\w+)`:? ([^`]+?)(?=(?:[.;]\s+`\w+`)|\.?\s*$)", docstring(kind)):
            if name in kind.model_fields:
                found.setdefault(name, " ".join(text.split()).strip(" .,;") + ".")
    return found


def docstring(kind: type) -> str:
    """What a class says of itself, from its source where Python (`-OO`) dropped it."""
    if kind.__doc__ is not None:
        return inspect.cleandoc(kind.__doc__)
    source = _source(kind)
    return "" if source is None else ast.get_docstring(source) or ""


@cache
def _source(kind: type) -> ast.ClassDef | None:
    """None where there is none."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError, SyntaxError):
        return None
    return tree.body[0] if isinstance(tree.body[0], ast.ClassDef) else None


def _strings_below(kind: type[BaseModel]) -> dict[str, str]:
    source, found = _source(kind), dict[str, str]()
    for above, below in pairwise(() if source is None else source.body):
        if (
            isinstance(above, ast.AnnAssign)
            and isinstance(above.target, ast.Name)
            and isinstance(below, ast.Expr)
            and isinstance(below.value, ast.Constant)
            and isinstance(below.value.value, str)
        ):
            found[above.target.id] = " ".join(below.value.value.split())
    return found
