"""`nlos completion`: what a shell needs to complete verbs and options."""

from typing import Annotated, Literal

import typer
from typer._completion_shared import get_completion_script

from nlos.cli.terminal import terminal

VARIABLE = "_NLOS_COMPLETE"


def completion(shell: Annotated[Literal["bash", "zsh", "fish"], typer.Argument(metavar="bash|zsh|fish")]) -> None:
    """Prints the script; `eval "$(nlos completion bash)"` in ~/.bashrc switches completion on."""
    script = get_completion_script(prog_name="nlos", complete_var=VARIABLE, shell=shell)
    terminal.result(script)
    terminal.document["script"] = script
