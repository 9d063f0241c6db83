"""`nlos serve`: a recording's samples to another machine, for whoever holds its ticket."""

import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.served.address import listening_address
from nlos.cli.exit_codes import UsageError
from nlos.cli.interrupts import served_until_told
from nlos.cli.seconds import check_seconds
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.served.server import SampleServer


def serve(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A recording, finished or growing.")],
    host: Annotated[str, typer.Option(help="Address to listen on. Default: this machine only.")] = ("127.0.0.1"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 picks a free one.")] = 0,
    idle_s: Annotated[
        float, typer.Option(metavar="S", help="Stop this many seconds after the scan and the last request.")
    ] = 60.0,
) -> None:
    """Writes RUN.ticket; `nlos reconstruct RUN.ticket --follow` on the other machine does the rest. Ctrl-C ends it."""
    check_seconds("--idle-s", idle_s)
    from nlos.acquisition.served.server import AddressTaken, SampleServer  # needs the extra `live`

    try:
        address = listening_address(host)
    except ValueError as error:
        raise UsageError(f"--host {error}") from error
    open_checked(run).close()
    try:
        server = SampleServer(run, address, port)
    except AddressTaken as error:
        raise UsageError(f"--host {host} --port {port}: {error}. Choose another.") from error
    stop = threading.Event()
    ticket = run.with_suffix(".ticket")
    idle = _Idle(server, run, idle_s)
    with served_until_told(stop.set):
        try:
            server.ticket.save(ticket)
            terminal.result(f"{ticket}: {server.ticket.address}", ticket=str(ticket), address=server.ticket.address)
            server.serve(lambda: not (stop.is_set() or idle()))
        finally:
            server.close()
            server.ticket.withdraw(ticket)
        terminal.log(f"{run}: {server.answers} requests answered")


class _Idle:
    """Whether scan and questions have been over for long enough. A scan that is resumed is under way again."""

    def __init__(self, server: "SampleServer", run: Path, idle_s: float) -> None:
        self._server, self._run, self._idle_s = server, run, idle_s
        self._asked, self._since_s = 0, time.monotonic()
        self._left = False

    def __call__(self) -> bool:
        server, now_s = self._server, time.monotonic()
        if server.left and not self._left:
            terminal.log(
                f"{self._run}: nobody writes it any more although it says that its scan is running. What is there is "
                f"served for {self._idle_s:g} s after the last question; `nlos scan ... --resume` takes the rest."
            )
        self._left = server.left
        if server.answers != self._asked or not server.over:
            self._asked, self._since_s = server.answers, now_s
        return now_s - self._since_s > self._idle_s
