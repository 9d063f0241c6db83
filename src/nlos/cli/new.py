"""`nlos new bench`: asks, looks at what is plugged in, writes a commented bench file and ends with the doctor."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from nlos.cli.doctor import doctor
from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal
from nlos.new_bench.detection import detect
from nlos.new_bench.questions import Question, questions
from nlos.new_bench.writing import bench_text, blocks_of


def new(
    what: Annotated[str, typer.Argument(metavar="bench")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.yaml")] = Path("bench.yaml"),
    name: Annotated[str | None, typer.Option(help="The bench's name; default: the file's.")] = None,
    answer: Annotated[
        list[str] | None,
        typer.Option("--answer", metavar="KEY=VALUE", help="An answer given before, so that it is not asked for."),
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="A simulated table with these instruments, to rehearse on.")
    ] = False,
    check: Annotated[bool, typer.Option(help="End with `nlos doctor`, in the dark.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> int:
    """Writes a bench file by questions. On a terminal each is asked, with what is plugged in as its default; elsewhere
    defaults are taken, and what has none has to be given with --answer."""
    if what != "bench":
        raise UsageError(f"new {what}: only `nlos new bench` is known")
    if output.exists() and not overwrite:
        raise FileExistsError(f"{output}: exists. Choose another name with -o, or use --overwrite.")
    given = dict(_split(each) for each in answer or [])
    said: dict[str, str] = {}
    for ask in questions(detect(), simulated):
        question = ask(said)
        if question is not None:
            said[question.key] = _answer(question, given.pop(question.key, None))
    if given:
        raise UsageError(f"--answer {', '.join(given)}: no such question; the questions are: {', '.join(said)}")
    try:
        text = bench_text(blocks_of(name or output.stem, said, simulated))
    except ValidationError as error:
        why = "; ".join(each["msg"].removeprefix("Value error, ") for each in error.errors())
        raise UsageError(f"these answers do not make a valid bench file: {why}") from error
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(text, encoding="utf-8")
    terminal.result(f"{output}: written; every line says what it means", bench_file=str(output), answers=said)
    if not check:
        return 0
    terminal.result("")
    return doctor(bench=str(output))


def _split(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--answer {text}: write KEY=VALUE")
    return key, value


def _answer(question: "Question", given: str | None) -> str:
    """As given, as typed, or the default. Raises `UsageError` where nobody is there to ask."""
    if given is not None:
        if why := question.refusal(given):
            raise UsageError(f"--answer {question.key}: {why}")
        return given
    if not sys.stdin.isatty():
        if question.default is None:
            raise UsageError(f"no answer to: {question.text}. Use --answer {question.key}=...")
        return question.default
    words = f" ({', '.join(question.choices)})" if question.choices else ""
    default = "" if question.default is None else f" [{question.default}]"
    while True:
        print(f"{question.text}{words}{default}: ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise UsageError(f"no answer to: {question.text}")
        typed = line.strip() or question.default or ""
        why = question.refusal(typed)
        if not why:
            return typed
        print(f"  {why}", file=sys.stderr)
