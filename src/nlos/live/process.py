"""The live page of a running scan, in a process of its own: it can be killed, stopped or slow, the scan continues."""

import json
import os
import secrets
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal
from nlos.recon.methods import PLAIN, catalogue, find, torch_is_installed

if TYPE_CHECKING:
    from nlos.recon.live import LivePicture

SOCKET, TOKEN, BEFORE = "NLOS_LIVE_SOCKET", "NLOS_LIVE_TOKEN", "NLOS_LIVE_BEFORE"
IDLE_S = 60
NICENESS = 10
QUICK = "lct"
"""The method of the first pictures."""


def methods_for(asked: str | None) -> list[str]:
    """The methods whose pictures a page shows, the quickest first: LCT, then `asked`, or NANO where torch is installed.

    Before a scan begins, and without loading torch: raises `InvalidSettings` for a method that does not exist,
    `ModuleNotFoundError` for one whose packages are not installed, so that no page is promised that cannot be.
    """
    best = asked or ("nano" if torch_is_installed() else QUICK)
    if best not in catalogue():
        find(best)
    if best not in PLAIN and not torch_is_installed():
        raise ModuleNotFoundError(f"No module named 'torch', which {best} needs", name="torch")
    return [QUICK] if best == QUICK else [QUICK, best]


def start_live(
    run: Path, method: str | None, weights: object = None, response: str = "auto", constants: Path | None = None,
    before: int = 0,
) -> "subprocess.Popen[bytes]":  # fmt: skip
    """Starts the page of `run` and says its address. A scan whose light is on waits for nothing of it. `before`: its
    pictures are compared with one of so many samples, which is made first."""
    state_file(run).unlink(missing_ok=True)  # of an earlier scan, whose page was killed
    token = secrets.token_urlsafe(24)
    with listening(0) as door:
        command = [sys.executable, "-P", "-m", "nlos", "live", str(run), "--idle-s", str(IDLE_S)]
        command += [] if method is None else ["--method", method]
        command += [] if weights is None else ["--weights", str(weights)]
        command += [] if response == "auto" else ["--response", response]
        command += [] if constants is None else ["--constants", str(constants)]
        process = page_process([*command, "-q"], door, token, NICENESS, before=before)
        url = f"http://127.0.0.1:{door.getsockname()[1]}/{token}/"
    terminal.log(f"live: {url}", -1)
    terminal.document["live"] = {"url": url, "pid": process.pid}
    return process


def pages_can_be() -> bool:
    """Whether this system hands an open socket to a child."""
    return hasattr(os, "setpriority")


def check_pages(option: str) -> None:
    """That a page can be watched from a process of its own here. Raises `UsageError`: Windows hands no open socket to a
    child."""
    if not pages_can_be():
        raise UsageError(
            f"{option}: needs Linux or macOS. Leave it out; `nlos live RUN` in another window shows a recording that "
            "grows."
        )


def page_process(
    command: Sequence[str], door: socket.socket, token: str, niceness: int, stdin: int = subprocess.DEVNULL,
    before: int = 0,
) -> "subprocess.Popen[bytes]":  # fmt: skip
    """The process of a page, which is handed the socket it listens on, computes on one core, and gives way."""
    process = subprocess.Popen(
        command,
        env={**os.environ, SOCKET: str(door.fileno()), TOKEN: token, BEFORE: str(before), "OMP_NUM_THREADS": "1"},
        pass_fds=[door.fileno()],
        stdin=stdin,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.setpriority(os.PRIO_PROCESS, process.pid, os.getpriority(os.PRIO_PROCESS, 0) + niceness)
    return process


def listening(port: int) -> socket.socket:
    """A socket on the loopback interface. Raises `UsageError` where the port is taken."""
    try:
        return socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise UsageError(f"--port {port}: {error.strerror}. Choose another, or 0 for a free one.") from error


def state_file(run: Path) -> Path:
    """Where the live process says what it sees: the picture's samples and what it may be judged by."""
    return run.with_name(f"{run.name}.live")


def write_state(path: Path, picture: "LivePicture") -> None:
    """Replaces the file at once, so that a reader meets whole figures only. Raises `StorageError` where the disk does
    not take it."""
    import numpy as np

    from nlos.recon.wall_doubt import wanted_on_wall

    fresh = path.with_name(f"{path.name}.new")
    figures = {"change": picture.change, "error": picture.error, "bound": picture.bound}
    wanted = wanted_on_wall(picture.reconstruction)
    maps = {} if wanted is None else {name: np.round(each, 4).tolist() for name, each in vars(wanted).items()}
    try:
        with told_of(path, fresh):
            fresh.write_text(json.dumps({"samples": picture.samples, **figures, "wanted": maps}))
            fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def read_state(path: Path) -> dict[str, Any]:
    """What `write_state` wrote; empty where nothing is there, or nothing that makes sense."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
