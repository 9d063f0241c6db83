"""`--set key=value` words and `--weights FILE`, as a method and its settings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.contradictions import refuse_together
from nlos.cli.exit_codes import UsageError

Weights = Annotated[
    Path | None,
    typer.Option("--weights", metavar="FILE", help="Weights of your own: they say their method and architecture."),
]


def chosen_method(
    weights: Path | None, method: str | None, settings: Mapping[str, object], default: str = "lct"
) -> tuple[str, dict[str, object]]:
    """The method and settings that the options say. Raises `InvalidSettings` for weights that do not fit them."""
    if weights is None:
        return method or default, dict(settings)
    from nlos.recon.weights.described import use_weights

    refuse_together(
        "--weights", {"--set weights": "weights" in settings}, "they may be two files", "Name the weights once."
    )
    return use_weights(weights, method, settings)


def parse_settings(pairs: Sequence[str]) -> dict[str, object]:
    """`key=value` words as settings: numbers, true/false, none, lists as 8,16, or text. Raises `UsageError`."""
    chosen: dict[str, object] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key:
            raise UsageError(f"--set {pair}: must be key=value")
        if key in chosen:
            raise UsageError(f"--set {key}: given twice")
        chosen[key] = _value(text)
    return chosen


def _value(text: str) -> object:
    if "," in text:
        return tuple(_value(part) for part in text.split(",") if part)
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False, "none": None, "null": None}.get(text.lower(), text)
