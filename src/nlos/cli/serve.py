"""`nlos serve`: a recording's samples to another machine, for whoever holds its ticket."""

import signal
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal


def serve(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A recording, finished or growing.")],
    host: Annotated[str, typer.Option(help="The address to listen on; nothing but this machine unless told.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 0,
    idle_s: Annotated[float, typer.Option(metavar="S", help="Ends so long after scan and last question.")] = 60.0,
) -> None:
    """Writes RUN.ticket; `nlos reconstruct RUN.ticket --follow` on the other machine does the rest. Ctrl-C ends it."""
    from nlos.acquisition.network.server import SampleServer
    from nlos.acquisition.recording.recording import Recording, Status

    if host in ("0.0.0.0", "::", "*"):
        raise UsageError(f"--host {host}: name the one address by which the other machine reaches this one")
    Recording.open(run).close()
    try:
        server = SampleServer(run, host, port)
    except OSError as error:
        raise UsageError(f"--host {host} --port {port}: {error}") from error
    stop = threading.Event()

    def ended(number: int, frame: FrameType | None) -> None:
        stop.set()

    previous = {number: signal.signal(number, ended) for number in (signal.SIGINT, signal.SIGTERM)}
    ticket = run.with_suffix(".ticket")
    server.ticket.save(ticket)
    terminal.result(f"{ticket}: {server.ticket.address}", ticket=str(ticket), address=server.ticket.address)
    looked_s = asked_s = time.monotonic()
    over, asked = False, 0

    def go_on() -> bool:
        nonlocal looked_s, asked_s, over, asked
        now_s = time.monotonic()
        if server.answers != asked:
            asked, asked_s = server.answers, now_s
        if not over and now_s - looked_s > 1.0:
            looked_s = now_s
            with Recording.open(run) as recording:
                over = recording.status is not Status.RUNNING
        return not (stop.is_set() or (over and now_s - asked_s > idle_s))

    try:
        server.serve(go_on)
    finally:
        server.close()
        ticket.unlink(missing_ok=True)
        for number, handler in previous.items():
            signal.signal(number, handler)
    terminal.log(f"{run}: {server.answers} questions answered")
