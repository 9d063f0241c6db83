"""`nlos new bench`: asks, looks at what is plugged in, writes a commented bench file and ends with the doctor."""

from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from nlos.acquisition.recording.new_name import file_to_write
from nlos.calibration.bench_facts import REAL, SIMULATED
from nlos.cli.doctor import doctor
from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import refuse_existing
from nlos.cli.terminal import terminal
from nlos.new_bench.asking import answers, as_options
from nlos.new_bench.detection import detect
from nlos.new_bench.hints import HINTS
from nlos.new_bench.questions import questions
from nlos.new_bench.unfinished import Unfinished
from nlos.new_bench.writing import attenuators, bench_text, blocks_of
from nlos.whole_file import whole_file
from nlos.writable import check_writable


def new(
    what: Annotated[str, typer.Argument(metavar="bench")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.yaml")] = Path("bench.yaml"),
    name: Annotated[str | None, typer.Option(help="The bench's name; default: the file's.")] = None,
    answer: Annotated[
        list[str] | None,
        typer.Option(
            "--answer",
            metavar="KEY=VALUE",
            help=f"An answer given before, so that it is not asked for. Keys, where they apply: {', '.join(HINTS)}.",
        ),
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
    refuse_existing(output, overwrite)
    check_writable(file_to_write(output).absolute().parent)
    given = dict(_split(each) for each in answer or [])
    if simulated and "port" in given:
        raise UsageError(
            f"--answer port={given['port']}: a simulated table has no port. Leave it out, or leave out --simulated."
        )
    unfinished = Unfinished(output, SIMULATED if simulated else REAL)
    try:
        said = answers(questions(detect(), simulated), given, unfinished)
    except (KeyboardInterrupt, UsageError):
        if unfinished.path.exists():
            terminal.log(f"{unfinished.path}: your answers so far; the same command offers them again")
        raise
    try:
        content = blocks_of(name or output.stem, said, simulated)
        text = bench_text(content)
    except ValidationError as error:
        why = "; ".join(_said(each) for each in error.errors())
        raise UsageError(f"these answers do not make a valid bench file: {why}. {as_options(said)}") from error
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(output, new=not overwrite) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError:
        terminal.log(as_options(said))
        raise
    unfinished.forget()
    terminal.result(f"{output}: written; every line says what it means", bench_file=str(output), answers=said)
    for warning in attenuators(content):
        terminal.log(f"warning: {warning}")
    if not check:
        return 0
    terminal.result("")
    return doctor(bench=str(output))


def _said(error: ErrorDetails) -> str:
    if error["type"] != "missing":
        return error["msg"].removeprefix("Value error, ")
    role, *_, key = error["loc"]
    return f"its {role} needs `{key}` too, which nobody asks for here: write the file by hand (`nlos schema bench`)"


def _split(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--answer {text}: write KEY=VALUE")
    return key, value
