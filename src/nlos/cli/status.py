"""`nlos status`: a read-only page for the corridor: the scan under way, the series, the latest runs."""

import os
import re
import secrets
import socket
from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.served.address import listening_address
from nlos.cli.exit_codes import UsageError
from nlos.cli.interrupts import served_until_told
from nlos.cli.targets import check_folder
from nlos.cli.terminal import terminal
from nlos.drivers.state_folder import state_folder
from nlos.live.web import WebServer
from nlos.run_defaults import data_folder
from nlos.status_page import StatusPage

NICENESS = 10


def status(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="Default: the data folder of defaults.yaml, or this folder.")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 picks a free one.")] = 0,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="This computer's address that others reach it by.")
    ] = "127.0.0.1",
    token: Annotated[
        str | None, typer.Option(metavar="WORD", help="The secret in the page's address; a new one unless given.")
    ] = None,
) -> None:
    """A page that asks for itself again every few seconds. Whoever has its address may look; nobody can control
    anything. It is made from the files, by a process of its own: start it on any machine that sees the data folder.
    Ctrl-C ends it."""
    where = folder or data_folder() or Path()
    check_folder(where)
    if token is not None and not re.fullmatch("[A-Za-z0-9_-]{16,100}", token):  # what an address may hold
        raise UsageError("--token: 16 to 100 of a-z, A-Z, 0-9, - and _: it is all that keeps others out")
    state_folder()  # where there can be none, no page is ever made
    door, names = listening_at(host, port)
    if hasattr(os, "nice"):
        os.nice(NICENESS)  # a scan on this machine goes first
    word = token or secrets.token_urlsafe(24)
    server = WebServer(door, StatusPage(where, word, set(names)))

    with served_until_told(server.stop):
        url = f"http://{names[0]}/{word}/"
        terminal.result(url, url=url)
        server.run()


def listening_at(host: str, port: int) -> tuple[socket.socket, list[str]]:
    """A socket there, and what browsers that reach it call it, HOST:PORT in small letters as they send it. Raises
    `UsageError` where this computer has no such address, or all of them are meant, or the port is taken."""
    try:
        address = listening_address(host)
    except ValueError as error:
        raise UsageError(f"--host {error}") from error
    try:
        door = socket.create_server((address, port), family=socket.AF_INET6 if ":" in address else socket.AF_INET)
    except OSError as error:
        raise UsageError(f"--host {host} --port {port}: {error.strerror}. Choose another.") from error
    bound, port = door.getsockname()[:2]
    number = f"[{bound}]" if ":" in bound else bound
    named = number if ":" in host else host.lower()
    return door, [f"{name}:{port}" for name in (named, number, socket.gethostname().lower(), "127.0.0.1", "localhost")]
