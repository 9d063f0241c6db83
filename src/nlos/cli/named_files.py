"""The arguments that name a scan or a bench, the same in every verb, with what a shell completes them by."""

from typing import Annotated

import typer

from nlos.configs.load import names


def _scans(incomplete: str) -> list[str]:
    """Shipped scans that begin so; a shell adds the files."""
    return [name for name in names("scan") if name.startswith(incomplete)]


def _benches(incomplete: str) -> list[str]:
    return [name for name in names("bench") if name.startswith(incomplete)]


ScanWord = Annotated[
    str,
    typer.Argument(metavar="SCAN", help="A YAML file, or the name of one in configs/scan.", autocompletion=_scans),
]
BenchWord = Annotated[
    str | None,
    typer.Option("--bench", metavar="BENCH", help="Default: the simulated bench.", autocompletion=_benches),
]
