"""`--set key=value` words, as settings of a method."""

from collections.abc import Sequence

from nlos.cli.exit_codes import UsageError


def parse_settings(pairs: Sequence[str]) -> dict[str, object]:
    """`key=value` words as settings: numbers, true/false, or text. Raises `UsageError`."""
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
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
