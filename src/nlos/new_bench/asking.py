"""Puts the questions of a bench file: on a terminal one after the other and back again, elsewhere none."""

import shlex
import sys
from collections.abc import Mapping, Sequence

from nlos.cli.agreeing import asked_again
from nlos.cli.exit_codes import UsageError
from nlos.new_bench.hints import HINTS
from nlos.new_bench.questions import Asking, Question
from nlos.new_bench.unfinished import Unfinished

BACK = "<"


def answers(asking: Sequence[Asking], given: Mapping[str, str], earlier: Unfinished | None = None) -> dict[str, str]:
    """Key -> answer, in the order of the questions: as given, as typed, or the default. Where nobody is there to be
    asked, what has no default must be given. `earlier`: what was typed before goes before defaults, and what is typed
    is kept there.

    Raises `UsageError` for an answer that is none, and for one that is given to no question.
    """
    on_terminal = sys.stdin.isatty()
    if on_terminal:
        _say(f"Enter takes what is in brackets; {BACK} goes back to the question before; Ctrl-C writes no bench file.")
    said: dict[str, str] = {}
    typed = earlier.load() if on_terminal and earlier is not None else {}
    if typed and earlier is not None:
        _say(f"In brackets are the answers of the last time, where they differ from what is usual ({earlier.path}).")
    back: list[tuple[int, dict[str, str]]] = []
    at = 0
    while at < len(asking):
        question = asking[at](said)
        if question is not None:
            if question.key in given or not on_terminal:
                answer = _taken(question, given.get(question.key))
            else:
                found = _asked(question, typed.get(question.key))
                if found is None and not back:
                    _say("  this is the first question")
                    continue
                if found is None:
                    at, said = back.pop()
                    continue
                answer = found
                back.append((at, said))
                if answer != question.default:
                    typed[question.key] = answer
                else:
                    typed.pop(question.key, None)
                if earlier is not None:
                    earlier.keep(typed)
            said = {**said, question.key: answer}
        at += 1
    if unknown := given.keys() - said.keys():
        raise UsageError(
            f"--answer {', '.join(sorted(unknown))}: no such question; the questions are: {', '.join(said)}. "
            f"{as_options(said)}"
        )
    return said


def as_options(said: Mapping[str, str]) -> str:
    """What was answered, so that nobody answers it twice."""
    words = " ".join(shlex.join(["--answer", f"{key}={value}"]) for key, value in said.items())
    return f"Your answers, to correct and to give again: {words}"


def _taken(question: Question, given: str | None) -> str:
    if given is not None:
        if why := question.refusal(given):
            raise UsageError(f"--answer {question.key}: {why}")
        return given
    if question.default is None:
        raise UsageError(f"no answer to: {question.text}. Use --answer {question.key}=...")
    return question.default


def _asked(question: Question, before: str | None) -> str | None:
    """What is typed, until it is an answer; None: back. What was typed `before` goes before the default."""
    default = question.default if before is None or question.refusal(before) else before
    words = f" ({', '.join(question.choices)})" if question.choices else ""
    if hint := HINTS.get(question.key):
        _say(f"  {hint}")
    shown = "" if default is None else f" [{default}]"

    def ask() -> None:
        print(f"{question.text}{words}{shown}: ", end="", file=sys.stderr, flush=True)

    while True:
        with asked_again(ask):
            ask()
            line = sys.stdin.readline()
        if not line:
            _say("")
            raise UsageError(f"no answer to: {question.text}. No bench file was written.")
        text = line.strip() or default or ""
        if text == BACK:
            return None
        if not (why := question.refusal(text)):
            return text
        _say(f"  {why}")


def _say(line: str) -> None:
    print(line, file=sys.stderr)
