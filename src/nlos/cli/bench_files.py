"""Bench files that a command writes: what it measured put into the one that was read."""

from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import check_place
from nlos.cli.terminal import terminal
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.configs.load import Loaded
    from nlos.drivers.bench_settings import BenchSettings


def check_bench_output(output: Path | None, overwrite: bool, what: str) -> None:
    """Before anything is measured. Raises `UsageError` for a name that is no bench file's, and as
    `check_place` does."""
    if output is None:
        return
    if output.suffix.lower() not in (".yaml", ".yml"):
        raise UsageError(f"-o {output}: {what} a bench file, .yaml")
    check_place(output, overwrite)


def write_bench_file(text: str, table: "Loaded[BenchSettings]", output: Path | None, overwrite: bool) -> None:
    """The new text of `table` to `output`; without one it is only read once more, and the way to write it is said."""
    from nlos.configs.load import parse
    from nlos.drivers.bench_settings import BenchSettings

    parse(text, str(output or table.path), BenchSettings)
    if output is None:
        terminal.log("not written: -o NEW.yaml writes a copy of the bench file with these lines")
        return
    output.absolute().parent.mkdir(exist_ok=True)
    with whole_file(output, new=not overwrite) as partial:
        partial.write_text(text, encoding="utf-8")
    terminal.result(f"{output}: {table.path.name} with these lines", bench=str(output))
