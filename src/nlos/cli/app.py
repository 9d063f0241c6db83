"""The verbs, each loaded only when it is called: `nlos --help` imports neither torch nor h5py."""

import difflib
import importlib
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from nlos.cli.exit_codes import UsageError

VERBS = {
    "devices": "Show what is plugged in, what the bench expects, and how to fix the difference.",
    "new": "Write a bench file by questions and detection: `nlos new bench`.",
    "shutter": "Close the laser shutter, whatever else on the bench is missing: `nlos shutter close`.",
    "doctor": "Check software, disk, links, mirror, counter, shutter and dark counts, and run a small scan.",
    "point": "Send the beam to one place on the wall; light only for as long as asked for.",
    "jog": "Move the beam by arrow keys, watch the counts, mark spots for calibration.",
    "monitor": "Show rates, sync, direct peak and histogram as they change.",
    "plan": "Check everything a scan would, move nothing, and predict its duration.",
    "scan": "Acquire a scan; on the simulated bench unless --bench names another.",
    "queue": "Take many scans one after the other, resumed after anything.",
    "runs": "Find scans again by sample, operator, note, tag or day.",
    "status": "Show the scan under way, the series and the latest runs on a read-only page.",
    "calibrate": "Measure the bench's constants from recordings, with their errors.",
    "reconstruct": "Reconstruct pictures of the hidden scene from recordings or imported files.",
    "serve": "Serve a growing recording's samples to another machine.",
    "live": "Show a scan on a read-only web page while it runs.",
    "replay": "Replay recorded samples through the same path as a live scan.",
    "import": "Convert other formats into a recording.",
    "export": "Convert a recording or a reconstruction into other formats.",
    "verify": "Check that every planned sample is there and is what was measured.",
    "recover": "Save what a crash left into a new file.",
    "info": "Show what is in a file.",
    "report": "Write one self-contained HTML file about a recording.",
    "figure": "Results side by side on one scale, at a journal's width.",
    "train": "Train a learned method.",
    "evaluate": "Compare methods on scenes with ground truth.",
    "methods": "List the reconstruction methods, or the settings of one.",
    "patterns": "List the scan patterns, or the settings of one.",
    "schema": "Print the JSON Schema of scan, bench, queue, defaults or training files.",
    "completion": "Print the script that switches on shell completion.",
}
"""Verb -> what it does. The function `VERB` (or `VERB_` for a Python keyword) lives in `cli/VERB.py`."""

EVERYWHERE = (
    "Everywhere: --json (stdout is one JSON document), -v / -q (more or less on stderr), "
    "--wire-log FILE (every byte to and from the devices), -V / --version, -h / --help."
)


MAY_BE_EMPTY = ("--sample", "--operator", "--note", "--name", "--titles")
"""What a person says of a scan or a picture; every other word names something."""

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"]}
NUMBERS = {**HELP, "ignore_unknown_options": True}
"""For a verb whose arguments are numbers: one below zero looks like an option."""


class LazyVerbs(TyperGroup):
    """A command group that knows its verbs' names and summaries, and imports a verb's file when it is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return TyperCommand(cmd_name, short_help=VERBS[cmd_name]) if cmd_name in VERBS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        word = args[0] if args else ""
        if word and not word.startswith("-") and word not in VERBS:
            begun = [verb for verb in VERBS if len(word) > 2 and verb.startswith(word)]
            near = begun if len(begun) == 1 else difflib.get_close_matches(word, VERBS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else "`nlos --help` lists the verbs."
            raise UsageError(f"there is no verb '{word}'; {hint}")
        refuse_empty(args[1:])
        name, command, rest = super().resolve_command(ctx, args)
        return name, load_verb(name) if name else command, rest


def refuse_empty(words: Sequence[str]) -> None:
    """Raises `UsageError` for an empty word, as a shell makes it of a variable that is not set: as a file it would be
    this folder, and as a bench the simulated one."""
    for before, word in pairwise(("", *words)):
        option = before if before.startswith("-") else ""
        if word.startswith("--") and word.endswith("=") and word.count("=") == 1:  # a second one is of the value
            option, word = word[:-1], ""
        if not word and option not in MAY_BE_EMPTY:
            place = f"{option} is" if option else "one word of this command is"
            raise UsageError(f"{place} empty. Is a variable of the shell not set? Say what is meant, or leave it out.")


def load_verb(name: str) -> Any:
    """The command for a verb, from its own file."""
    module = importlib.import_module(f"nlos.cli.{name}_" if name == "import" else f"nlos.cli.{name}")
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name, help=VERBS[name], epilog=EVERYWHERE, context_settings=NUMBERS if name == "point" else HELP)(
        getattr(module, module.__name__.split(".")[-1])
    )
    return typer.main.get_command(single)


app = typer.Typer(
    cls=LazyVerbs,
    name="nlos",
    help="Confocal non-line-of-sight imaging: from galvo mirrors and single photons to what is behind the corner.",
    epilog=EVERYWHERE,
    add_completion=False,
    no_args_is_help=True,
    context_settings=HELP,
    rich_markup_mode=None,
)


@app.callback()
def _verbs() -> None:
    """Makes `app` a group before any verb is loaded."""
