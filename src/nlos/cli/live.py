"""`nlos live`: a page on this machine that shows a scan while it runs, or a finished one along its time."""

import contextlib
import os
import secrets
import socket
import threading
import time
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.terminal import terminal


def live(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A recording, growing or finished.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 0,
    method: Annotated[str, typer.Option(help="A word of `nlos methods`.")] = "nano",
    idle_s: Annotated[
        float | None, typer.Option(metavar="S", help="Ends so long after the scan and the last question.")
    ] = None,
) -> None:
    """A read-only page on 127.0.0.1. Whoever has its address may look; nobody can control anything. Ctrl-C ends it."""
    import uvicorn

    from nlos.live.page import LivePage, application
    from nlos.live.process import SOCKET, TOKEN, listening, state_file, write_state
    from nlos.live.scan import LiveScan
    from nlos.recon.live import LiveReconstruction
    from nlos.recon.methods import find

    find(method)
    inherited = os.environ.pop(SOCKET, "")
    token = os.environ.pop(TOKEN, "") or secrets.token_urlsafe(24)
    door = socket.socket(fileno=int(inherited)) if inherited else listening(port)
    number = door.getsockname()[1]
    state = state_file(run) if inherited else None
    scan = LiveScan(
        run, LiveReconstruction(method), on_picture=None if state is None else lambda p: write_state(state, p)
    )
    page = LivePage(scan)
    hosts = {f"127.0.0.1:{number}", f"localhost:{number}"}
    config = uvicorn.Config(application(page, token, hosts), log_level="warning", lifespan="off", server_header=False)
    server = uvicorn.Server(config)
    url = f"http://127.0.0.1:{number}/{token}/"
    terminal.result(url, url=url)
    if not run.exists():
        terminal.log(f"waiting for {run}")
    scan.start()

    def end_when_idle() -> None:
        while not scan.failed and (idle_s is None or not scan.over or time.monotonic() - page.asked_s <= idle_s):
            time.sleep(0.5)
        server.should_exit = True

    threading.Thread(target=end_when_idle, daemon=True).start()
    try:
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[door])
    finally:
        scan.stop()
        if state is not None:
            state.unlink(missing_ok=True)
    if scan.failed and scan.error is not None:
        raise scan.error
