"""What a test has left behind in its process: descriptors, sockets, threads, and processes that outlive it."""

import contextlib
import gc
import os
import signal
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

GRACE_S = 3.0
"""What is ending by itself has ended by then."""
MARK = "NLOS_TEST_PROCESS"
"""In the environment of every process that a test starts, also of those that one of them has left behind."""
THREADS = {
    "tqdm_monitor": "tqdm's, one for the process",
    "asyncio_": "the default executor of an event loop, one for the loop",
    "IO loop": "dask's, one for the process",
    "Profile": "dask's, one for the process",
    "AsyncProcess": "dask's, ends with the process that it watches",
    "TCP-Executor": "dask's, one for the process",
    "Dask-": "dask's pools, one for the process",
    "Shuffle": "dask's, one for the process",
    "ZMQ Garbage": "pyzmq's, one for the process",
}
"""Beginning of a thread's name -> why it may stay."""
FILES = {
    "/dev/": "of the process: null, urandom, shm",
    "anon_inode:": "polls and wake-ups of an event loop or a ZMQ context that lives for the process",
    "pipe:": "wake-ups of the same",
}
"""Beginning of what a descriptor leads to -> why it may stay. A descriptor that says nothing is no evidence."""
PROCESSES = {
    "multiprocessing.resource_tracker": "Python's, one for the process",
    "multiprocessing.forkserver": "Python's, one for the process",
    "torch/_inductor": "its compilers, a pool for the process",
}
"""A word of a command line -> why that process may stay."""


@dataclass(frozen=True)
class Held:
    """What this process holds at one moment."""

    files: frozenset[tuple[int, str]] = field(default_factory=frozenset)
    threads: frozenset[threading.Thread] = field(default_factory=frozenset)
    processes: frozenset[tuple[int, str]] = field(default_factory=frozenset)

    @classmethod
    def now(cls) -> "Held":
        return cls(frozenset(_files()), frozenset(threading.enumerate()), frozenset(_processes()))

    def more_than(self, before: "Held") -> list[str]:
        """In words, what is here and was not there."""
        return [
            *(f"descriptor {number}: {leads_to}" for number, leads_to in sorted(self.files - before.files)),
            *(f"thread {thread.name}" for thread in self.threads - before.threads if not _stays(thread.name, THREADS)),
            *(f"process {number}: {words}" for number, words in sorted(self.processes - before.processes)),
        ]


def left_behind(before: Held) -> list[str]:
    """In words, what is still held and was not `before`, after what ends by itself has ended."""
    left = Held.now().more_than(before)
    until_s = time.monotonic() + GRACE_S
    while left and time.monotonic() < until_s:
        gc.collect()
        time.sleep(0.05)
        left = Held.now().more_than(before)
    return left


def end_processes(before: Held) -> None:
    """Kills what is not `before`: a program that a failed test left would take the processor from all that follow."""
    for number, _ in frozenset(_processes()) - before.processes:
        with contextlib.suppress(OSError):
            os.kill(number, signal.SIGKILL)


def _stays(name: str, why: dict[str, str]) -> bool:
    return any(name.startswith(beginning) for beginning in why)


def _files() -> list[tuple[int, str]]:
    found, kernels = [], _netlink()
    for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else []:
        try:
            leads_to = os.readlink(f"/proc/self/fd/{name}")
        except OSError:  # the one that lists them
            continue
        # A test may capture the standard streams, and matplotlib keeps its fonts open.
        if (
            int(name) > 2
            and not _stays(leads_to, FILES)
            and "/site-packages/" not in leads_to
            and leads_to not in kernels
        ):
            found.append((int(name), leads_to))
    return found


def _netlink() -> set[str]:
    """Sockets to the kernel: libusb hears of devices by one that lives for the process."""
    try:
        rows = Path("/proc/self/net/netlink").read_text().splitlines()[1:]
    except OSError:
        return set()
    return {f"socket:[{row.split()[-1]}]" for row in rows}


def _processes() -> list[tuple[int, str]]:
    """Those that a test of this process started, and theirs; one that is over and was never waited for counts. Every
    test asks several times, and most processes are older than this one: of them no more than one line is read."""
    if not os.path.isdir("/proc/self"):
        return []
    mark, own = f"{MARK}={os.getpid()}\0".encode(), os.getpid()
    *_, began = _stat(own)
    found = []
    for name in os.listdir("/proc"):
        if not name.isdecimal() or int(name) == own:
            continue
        number = int(name)
        try:
            if _stat(number)[2] < began:  # nothing that this process started
                continue
            if mark in _environment(number):
                words = Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if not any(word in words for word in PROCESSES):
                    found.append((number, words))
            elif _stat(number)[:2] == (b"Z", own):  # read anew: it may have ended since
                found.append((number, "is over, and nobody waited for it"))
        except OSError:
            continue
    return found


def _environment(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/environ").read_bytes()
    except OSError:  # another user's, or over
        return b""


def _stat(process: int) -> tuple[bytes, int, int]:
    """State, parent, and when it began in ticks since the system did: proc(5), fields 3, 4 and 22."""
    file = os.open(f"/proc/{process}/stat", os.O_RDONLY)
    try:
        fields = os.read(file, 4096).rpartition(b")")[2].split()
    finally:
        os.close(file)
    return fields[0], int(fields[1]), int(fields[19])
