"""Questions to somebody at the terminal; where nobody is there, the answer is no."""

import sys

from nlos.cli.terminal import terminal


def somebody_is_there() -> bool:
    """Whether a person can read a question and answer it."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def answer() -> str | None:
    """What was typed; None at the end of the input."""
    try:
        return input().strip().lower()
    except EOFError:
        return None


def agrees(what: str, word: str = "light") -> bool:
    """Whether somebody typed the word after having read what it means."""
    if not somebody_is_there():
        return False
    terminal.log(f'{what} Type "{word}" to agree, Enter to stop here.', -9)
    return answer() == word
