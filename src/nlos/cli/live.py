"""`nlos live`: a page on this machine that shows scans while they run, or finished ones along their time."""

import os
import secrets
import socket
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.recording.no_such_file import meant_by
from nlos.acquisition.recording.read_by_child import check_says_recording
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.bench_constants import NONE
from nlos.calibration.checked import load_checked
from nlos.cli.exit_codes import UsageError
from nlos.cli.file_words import Response
from nlos.cli.interrupts import served_until_told
from nlos.cli.method_settings import Weights, chosen_method
from nlos.cli.seconds import check_seconds
from nlos.cli.terminal import terminal
from nlos.live.own_process import prepare_process
from nlos.live.page import LivePage
from nlos.live.process import BEFORE, SOCKET, TOKEN, listening, methods_for, state_file, write_state
from nlos.live.resumed import picture_before
from nlos.live.scan import LiveScan
from nlos.live.taken_up import TakenUp
from nlos.live.web import WebServer
from nlos.recon.live import LiveReconstruction
from nlos.response import response_wanted

MOST_RUNS = 4
FIRST = 0.09
"""Of the points: with these the first picture begins, so that it is there soon after a tenth of them; files come in
blocks."""
LOOK_S = 0.02
ENDS_S = 15.0
"""How long a picture that is being made may take once the viewer is to end."""


def live(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Recordings, growing or finished, side by side.")
    ],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 picks a free one.")] = 0,
    method: Annotated[
        str | None,
        typer.Option(help="A name, or a file, ./mine.py. Default: NANO (LCT without torch), after a first one by LCT."),
    ] = None,
    weights: Weights = None,
    response: Response = "auto",
    constants: Annotated[
        Path | None, typer.Option(metavar="CONSTANTS.h5", help="Constants, or none. Default: the bench's newest.")
    ] = None,
    idle_s: Annotated[
        float | None, typer.Option(metavar="S", help="Stop this many seconds after the scan and the last request.")
    ] = None,
) -> None:
    """A read-only page on 127.0.0.1. Whoever has its address may look; nobody can control anything. Ctrl-C ends it."""
    check_seconds("--idle-s", idle_s)
    wanted = response_wanted(response)
    seeing: dict[str, object] = {}
    if weights is not None:
        method, seeing = chosen_method(weights, method, {})
    methods = methods_for(method)
    prepare_process()
    _refuse_too_many(runs)
    inherited, before = os.environ.pop(SOCKET, ""), int(os.environ.pop(BEFORE, "0"))
    token = os.environ.pop(TOKEN, "") or secrets.token_urlsafe(24)
    if not inherited:  # whose address somebody has already
        _refuse_what_is_no_recording(runs, constants)
    door = socket.socket(fileno=int(inherited)) if inherited else listening(port)
    number = door.getsockname()[1]
    state = state_file(runs[0]) if inherited else None
    scans = [
        LiveScan(
            run,
            [LiveReconstruction(each, seeing if each == method else {}) for each in methods],
            first_fraction=FIRST,
            constants=constants,
            response=wanted,
            begun=bool(inherited),
        )
        for run in runs
    ]
    if state is not None:
        scans[0].on_picture = lambda picture: write_state(state, picture)
    page = LivePage(scans, token, {f"127.0.0.1:{number}", f"localhost:{number}"})
    server = WebServer(door, page, page.nothing_new)
    taken_up, ended = TakenUp(scans, page, ENDS_S), threading.Event()

    def end_when_idle() -> None:
        while inherited or not all(scan.failed for scan in scans):  # there the page alone says why it shows nothing
            taken_up.look()
            busy = any(not (scan.over or scan.broke_off or scan.failed) for scan in scans)
            if idle_s is not None and not busy and time.monotonic() - page.asked_s > idle_s:
                break
            if ended.wait(0.5):
                return
        server.stop()

    with ExitStack() as until_told:
        try:
            if before and (seen := picture_before(runs[0], before, scans[0].lives[-1], constants, wanted)) is not None:
                assert state is not None
                write_state(state, seen)
            for scan in scans:
                scan.start()
            awaited = [] if inherited else [scan.run for scan in scans if not _begun(scan)]
            until_told.enter_context(served_until_told(server.stop))
            if not inherited:
                url = f"http://127.0.0.1:{number}/{token}/"
                terminal.result(url, url=url)
            for run in awaited:
                terminal.log(f"waiting for {run}" + (f". {meant}" if (meant := meant_by(run)) else ""))
            threading.Thread(target=end_when_idle, daemon=True).start()
            server.run()
        finally:
            ended.set()
            page.stop(ENDS_S)
            for scan in scans:
                scan.stop(ENDS_S)
            if state is not None:
                state.unlink(missing_ok=True)
        failed = next((scan.error for scan in scans if scan.failed and scan.error is not None), None)
        if failed is not None:
            raise failed


def _begun(scan: LiveScan) -> bool:
    """Waits until a recording that is there was opened. False while there is none yet; raises what is wrong with one
    that cannot be followed."""
    while scan.seen is None:
        if scan.error is not None:
            raise scan.error
        if not scan.run.exists():
            return False
        time.sleep(LOOK_S)
    return True


def _refuse_too_many(runs: list[Path]) -> None:
    """Raises `UsageError` for more than a page has room for, and for one that is named twice."""
    if len(runs) > MOST_RUNS:
        raise UsageError(f"{len(runs)} RUNs: a page shows up to {MOST_RUNS}. Open another page for the others.")
    for number, run in enumerate(runs):
        for earlier in runs[:number]:
            if run.resolve() == earlier.resolve():
                same = "is named twice" if run == earlier else f"and {earlier} are the same recording"
                raise UsageError(f"{run}: {same}. Name it once, or another beside it.")


def _refuse_what_is_no_recording(runs: list[Path], constants: Path | None) -> None:
    """Before anything is loaded: one that is not there yet, or that is being written, is waited for."""
    for run in runs:
        if run.exists() and not is_locked(run):
            check_says_recording(run)
    if constants is not None and constants != NONE:
        load_checked(constants)
