"""What else than its file a result of an archive was made with: method, settings and options, and what differs."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from nlos.cli.archive_inputs import sha256
from nlos.cli.archive_task import Task
from nlos.recon.own_methods import in_a_file, name_of
from nlos.response import ResponseWanted

FILES = ("method", "weights", "noise_weights", "constants")
"""Settings and options that may name a file; what counts is what that holds."""


def made_with(task: Task) -> dict[str, Any]:
    """Everything beside the file that makes the result what it is: method, settings, options that are not the usual
    ones. As plain values, files among them by name and content."""
    recipe, results = task.recipe, task.results
    options: dict[str, object] = {
        "method": recipe.method if in_a_file(recipe.method) else None,
        "constants": recipe.constants,
        "response": _said(recipe.response),
        "depth_m": results.depth_m,
        "html": results.html or None,
        "volume": None if results.volume else False,
        "frame": task.frame,
        **asdict(task.given),
    }
    made = {
        "method": name_of(recipe.method),
        "settings": {key: _by_content(value) if key in FILES else value for key, value in recipe.settings.items()},
        "options": {
            key: _by_content(value) if key in FILES else value for key, value in options.items() if value is not None
        },
    }
    return dict(json.loads(json.dumps(made, default=str)))


def _said(wanted: ResponseWanted) -> str | None:
    if wanted.auto:
        return None
    return "none" if wanted.response is None else f"{wanted.response.fwhm_s * 1e12:g} ps, {wanted.response.source}"


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """`KEY was A, now B` of two `made_with`; `before` may be of an earlier version, which kept no options."""
    was, is_ = dict(_flat(before)), dict(_flat(now))
    if "options" not in before:
        is_ = {key: value for key, value in is_.items() if not key.startswith("options.")}
    found = []
    for key in dict.fromkeys((*is_, *was)):
        if _content(was.get(key)) != _content(is_.get(key)):
            found.append(f"{key.partition('.')[2] or key} was {_name(was.get(key))}, now {_name(is_.get(key))}")
    return found


def _by_content(value: object) -> object:
    path = Path(value) if isinstance(value, str | Path) else None
    if path is None or not path.is_file():
        return value
    return {"file": str(path), "sha256": _of_file(path.resolve(), path.stat().st_mtime_ns)}


@lru_cache(maxsize=32)
def _of_file(path: Path, modified_ns: int) -> str:
    """Of one file, read once for all tasks."""
    del modified_ns
    return sha256(path)


def _flat(made: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key in ("settings", "options"):
        yield from ((f"{key}.{name}", value) for name, value in made.get(key, {}).items())
    yield "method", made["method"]


def _content(value: object) -> object:
    return value["sha256"] if isinstance(value, dict) and "sha256" in value else value


def _name(value: object) -> object:
    return value["file"] if isinstance(value, dict) and "file" in value else value
