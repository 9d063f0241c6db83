"""What the user asked to see: results on stdout, progress and log on stderr, one JSON document with --json."""

import json
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nlos.cli.columns import columns_shown, folded
from nlos.cli.escaped import escaped
from nlos.drivers.exit_paths import tell_to_end


@dataclass
class Terminal:
    """The options that every verb knows, and the two streams. One per process: `terminal`."""

    as_json: bool = False
    verbosity: int = 0
    wire_log: Path | None = None
    wire_log_begun: bool = False
    """A command that opens its bench again goes on in the same file."""
    wire_log_whole: bool = True
    document: dict[str, Any] = field(default_factory=dict)
    about: str = ""
    """The file, of several, that the library's log is of."""

    end_said: str = ""
    """By which words it was told that a signal ends the command."""

    def begin(self) -> None:
        """A command of its own: nothing that an earlier one of this process was told, or said, is in it."""
        self.as_json, self.verbosity, self.wire_log, self.document, self.about = False, 0, None, {}, ""
        self.wire_log_begun, self.wire_log_whole, self.end_said = False, True, ""
        tell_to_end(False)

    def result(self, text: str, **values: Any) -> None:
        """A line of the result. Its values go into the JSON document instead with --json."""
        self.document.update(values)
        if not self.as_json:
            print(folded(escaped(text), columns_shown()), flush=True)

    def log(self, text: str, level: int = 0) -> None:
        """A line on stderr, shown when the verbosity is at least `level` (-1 shows even with -q)."""
        if self.verbosity >= level:
            print(escaped(text), file=sys.stderr, flush=True)

    def say_end(self, text: str) -> None:
        """What became of the command that a signal ends, said once: on stderr now, in the JSON document at the end."""
        self.end_said = text
        self.log(f"nlos: {text}", -9)

    @contextmanager
    def log_of(self, file: str) -> Iterator[None]:
        """What the library logs meanwhile is of this file."""
        self.about = file
        try:
            yield
        finally:
            self.about = ""

    @contextmanager
    def results_alone(self) -> Iterator[None]:
        """With --json stdout is left to the document: what somebody's method or driver prints meanwhile, or a program
        that it calls, goes to stderr."""
        if not self.as_json:
            yield
            return
        with _stdout_to_stderr(), redirect_stdout(sys.stderr):
            yield

    def finish(self) -> None:
        """Prints the JSON document, when that was asked for."""
        if self.as_json:
            # JSON has no word for what is not finite: a strict reader would take nothing of a document that holds one.
            plain = json.loads(json.dumps(self.document, default=str), parse_constant=lambda word: None)
            print(json.dumps(plain, allow_nan=False), flush=True)


@contextmanager
def _stdout_to_stderr() -> Iterator[None]:
    """File number 1 is 2 meanwhile; nothing happens where stdout is not 1, as in another program's process."""
    try:
        kept = os.dup(1) if sys.stdout.fileno() == 1 else None
    except (OSError, ValueError):
        kept = None
    if kept is None:
        yield
        return
    sys.stdout.flush()
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        with suppress(OSError):  # nothing went there meanwhile; of what comes, `refused_results` asks
            os.close(kept)


terminal = Terminal()


class TerminalHandler(logging.Handler):
    """Shows what the library logs: warnings and information as they come, details with -v."""

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if terminal.about and not text.startswith(f"{terminal.about}: "):
            text = f"{terminal.about}: {text}"
        if record.levelno >= logging.WARNING:
            terminal.log(f"warning: {text}")
        else:
            terminal.log(text, 0 if record.levelno >= logging.INFO else 1)


def show_library_log() -> None:
    """From here on, what `nlos` logs appears on the terminal. May be called twice."""
    library = logging.getLogger("nlos")
    library.setLevel(logging.DEBUG)
    library.propagate = False
    if not any(isinstance(handler, TerminalHandler) for handler in library.handlers):
        library.addHandler(TerminalHandler())


def take_global_options(arguments: list[str]) -> tuple[list[str], bool]:
    """Removes the options that are allowed everywhere and sets `terminal` by them.

    Returns the other arguments and whether --version was asked for. Raises `ValueError` for a --wire-log without a
    file, once all of them are taken. Everything after `--` is left alone.
    """
    terminal.begin()
    rest: list[str] = []
    version = lacking = False
    pending = list(arguments)
    while pending:
        word = pending.pop(0)
        if word == "--":
            rest += [word, *pending]
            break
        match word:
            case "--json":
                terminal.as_json = True
            case "--verbose":
                terminal.verbosity += 1
            case "--quiet":
                terminal.verbosity -= 1
            case _ if len(word) > 1 and word[0] == "-" and not word[1:].strip("qv"):  # also -vv
                terminal.verbosity += word.count("v") - word.count("q")
            case "-V" | "--version":
                version = True
            case "--wire-log":
                if not pending or not pending[0] or pending[0].startswith("-"):  # the next option is no file
                    lacking = True
                else:
                    terminal.wire_log = Path(pending.pop(0))
            case "--wire-log=":
                lacking = True
            case _ if word.startswith("--wire-log="):
                terminal.wire_log = Path(word.partition("=")[2])
            case _:
                rest.append(word)
    if lacking:
        raise ValueError("--wire-log needs a file")
    return rest, version
