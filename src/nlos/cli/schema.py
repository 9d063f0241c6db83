"""`nlos schema`: the JSON Schema of scan, bench, queue and training files, and of one's own defaults, for editors."""

import json
from typing import Annotated, Literal

import typer

from nlos.cli.terminal import terminal
from nlos.schemas import schema_of


def schema(
    kind: Annotated[
        Literal["scan", "bench", "queue", "defaults", "train"],
        typer.Argument(metavar="scan|bench|queue|defaults|train"),
    ],
) -> None:
    """Prints the JSON Schema of a kind of YAML file. An editor that knows the YAML language server completes keys after
    a first line `# yaml-language-server: $schema=FILE`."""
    made = schema_of(kind)
    terminal.result(json.dumps(made, indent=2))
    terminal.document["schema"] = made
