"""Tells whom a bench file names how a run ended: a command, a web address, a mail. Nothing of it can harm the run."""

import json
import os
import smtplib
import subprocess
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from email.message import EmailMessage
from functools import partial
from http.client import HTTPException
from pathlib import Path

from nlos.acquisition.recording.run_notes import RunNotes
from nlos.cli.exit_codes import ExitCode, exit_code
from nlos.cli.terminal import terminal
from nlos.drivers.run_defaults import HookSettings, MailSettings

DONE, ALARM, INTERRUPTED = "done", "alarm", "interrupted"


@dataclass(frozen=True)
class Ending:
    """How a run, or a series, ended."""

    run: str
    """The recording, or the series' folder."""
    status: str
    """`done`, `alarm` (an alarm, a trip, or an error), or `interrupted` by a person."""
    message: str
    exit_code: int
    sample: str = ""
    operator: str = ""
    note: str = ""
    tags: tuple[str, ...] = ()


@contextmanager
def told(hooks: HookSettings, run: Path, notes: RunNotes) -> Iterator[None]:
    """Tells how the block ended, once it has: the bench is closed and dark by then. A person who interrupts is told
    nothing new."""
    try:
        yield
    except BaseException as error:
        code = exit_code(error)
        if code not in (ExitCode.INTERRUPTED, ExitCode.TERMINATED, ExitCode.USAGE) and not isinstance(
            error, SystemExit
        ):
            tell(hooks, Ending(str(run), ALARM, str(error), int(code), **asdict(notes)))
        raise
    tell(hooks, Ending(str(run), DONE, f"{run}: done", 0, **asdict(notes)))


def tell(hooks: HookSettings, ending: Ending) -> None:
    """Everybody who is to be told; what fails is said in the terminal, and is all that happens."""
    ways: dict[str, Callable[[], None]] = {}
    if command := {DONE: hooks.done, ALARM: hooks.alarm}.get(ending.status):
        ways["command"] = partial(_command, command, ending, hooks.deadline_s)
    if hooks.webhook:
        ways["webhook"] = partial(_post, hooks.webhook, ending, hooks.deadline_s)
    if hooks.mail:
        ways["mail"] = partial(_mail, hooks.mail, ending, hooks.deadline_s)
    for name, go in ways.items():
        try:
            go()
        except (OSError, subprocess.SubprocessError, smtplib.SMTPException, HTTPException, ValueError) as error:
            terminal.log(f"warning: {name} of {ending.run} was not told: {error}")


def _command(command: str, ending: Ending, deadline_s: float) -> None:
    """Through the shell, in a group of its own, so that all of it ends at the deadline. Raises `OSError`."""
    said = {f"NLOS_{name.upper()}": _text(value) for name, value in asdict(ending).items()}
    child = subprocess.Popen(
        command, shell=True, env={**os.environ, **said}, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True,
    )  # fmt: skip
    try:
        _, complaint = child.communicate(timeout=deadline_s)
    except BaseException:  # its deadline, or a person's Ctrl-C
        _end_group(child)
        raise
    if child.returncode:
        raise OSError(f"`{command}` ended with {child.returncode}: {complaint.strip()[-200:]}")


def _end_group(child: "subprocess.Popen[str]") -> None:
    if hasattr(os, "killpg"):
        os.killpg(child.pid, 9)
    else:
        child.kill()
    child.wait()


def _text(value: object) -> str:
    words = ",".join(value) if isinstance(value, tuple) else str(value)
    return words.replace("\0", "")


def _post(address: str, ending: Ending, deadline_s: float) -> None:
    body = json.dumps(asdict(ending)).encode()
    request = urllib.request.Request(address, body, {"Content-Type": "application/json"}, method="POST")
    with urllib.request.urlopen(request, timeout=deadline_s) as answer:
        answer.read(1)


def _mail(mail: MailSettings, ending: Ending, deadline_s: float) -> None:
    letter = EmailMessage()
    letter["From"], letter["To"] = mail.sender, ", ".join(mail.to)
    letter["Subject"] = f"nlos: {ending.status}: {Path(ending.run).name} {ending.sample}".strip().replace("\n", " ")
    letter.set_content("\n".join(f"{name}: {_text(value)}" for name, value in asdict(ending).items()))
    with smtplib.SMTP(mail.server, mail.port, timeout=deadline_s) as server:
        server.send_message(letter)
