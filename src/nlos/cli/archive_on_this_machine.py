"""`--scheduler local` and `local:N`: how many processes do an archive here, and from when on."""

import time
from collections.abc import Iterator

from nlos.cli.archive_crew import Crew
from nlos.cli.archive_on_dask import local_workers
from nlos.cli.archive_task import Outcome
from nlos.cli.exit_codes import UsageError
from nlos.recon.control_group import processors

LOCAL = "local"
STARTUP_S = 12.0
"""Workers are started for no less than this much saved; on busy cores, where they take longer to start, for more."""


def processes_of(scheduler: str) -> int | None:
    """How many processes `local` or `local:N` asks for; None for the address of a scheduler. Raises `UsageError`."""
    word, _, count = scheduler.partition(":")
    if word != LOCAL:
        return None
    if scheduler == LOCAL:
        return processors()
    if not (count.isdecimal() and int(count)):
        raise UsageError(f"--scheduler {scheduler}: local:N is expected, N processes on this machine, 1 or more.")
    return int(count)


def begun_when_worth_it(crew: Crew, processes: int) -> Iterator[Outcome]:
    """The outcomes of a crew that does files here, and has `processes` - 1 workers once they save more than they
    cost. It never waits for them: files are done here while they start."""
    seconds: list[float] = []
    begun = processes == 1
    clock = (time.monotonic(), time.process_time())
    for taken, outcome in enumerate(crew.outcomes(), 1):
        yield outcome
        if begun or taken == 1:  # the first one also loads
            clock = (time.monotonic(), time.process_time())
            continue
        seconds = sorted([*seconds, outcome.seconds or 0.0])
        left = crew.left()
        many = min(processes, max(left, 1))
        saved_s = left * seconds[len(seconds) // 2] * (1 - 1 / many)
        slower = (time.monotonic() - clock[0]) / max(time.process_time() - clock[1], 1e-9)
        if saved_s > STARTUP_S * max(1.0, slower):
            crew.begin_workers(local_workers(many - 1))
            begun = True
