"""Runs commands on a disk that goes bad, each in a fork of its own that ends as a command ends; `bad_disk.so` is loaded
before the C library. One JSON request a line in (`bad`, `arguments`, `folder`), one answer a line out."""

import ctypes
import json
import os
import sys
import time
from pathlib import Path

import nlos.acquisition.scanning.engine
import nlos.cli.queue
import nlos.cli.scan
import nlos.cli.verify
import nlos.series.sweep
from nlos.__main__ import run
from nlos.acquisition.served.served_copy import copy_served
from nlos.acquisition.served.ticket import Ticket

SHIM = ctypes.CDLL(None)
DEADLINE_S = 120.0


def copied(ticket: str, target: str) -> int:
    """What the copying process of `reconstruct --follow` does."""
    copy_served(Ticket.load(Path(ticket)), Path(target))
    return 0


def ended(bad: str, arguments: list[str], folder: str) -> dict[str, object]:
    """How the command ended: its exit code, or minus the signal that ended it; None where it hung."""
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        for stream, name in ((sys.stdout, "stdout"), (sys.stderr, "stderr")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream.fileno())
        os.environ["BAD_DISK"] = bad  # for this command's own children
        SHIM.bad_disk_arm(bad.encode())
        sys.exit(copied(*arguments[1:]) if arguments[0] == "copy" else run(arguments))
    deadline_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return {"code": os.waitstatus_to_exitcode(status)}
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return {"code": None}


def main() -> None:
    answers = os.dup(1)
    for line in sys.stdin:
        os.write(answers, (json.dumps(ended(**json.loads(line))) + "\n").encode())


if __name__ == "__main__":
    assert nlos.acquisition.scanning.engine
    assert nlos.cli.queue
    assert nlos.cli.scan
    assert nlos.series.sweep
    assert nlos.cli.verify
    main()
