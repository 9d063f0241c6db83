"""Options that exclude one another are refused: none is silently taken for the other, none goes unheard."""

from collections.abc import Mapping

from nlos.cli.exit_codes import UsageError


def refuse_together(option: str, others: Mapping[str, bool], why: str, instead: str) -> None:
    """`others`: option -> whether it was given. Raises `UsageError` naming those that were, beside `option`."""
    if given := [name for name, is_given in others.items() if is_given]:
        raise UsageError(f"{option} with {', '.join(given)}: {why}. {instead}")


def refuse_without(option: str, is_given: bool, needed: str, what: str) -> None:
    """Raises `UsageError` where `option` is given and has nothing to act on: `needed` is missing."""
    if is_given:
        raise UsageError(f"{option} without {needed}: {what}. Use {needed} as well, or leave {option} out.")
