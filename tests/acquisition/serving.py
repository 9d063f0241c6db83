"""A server of samples in a thread of its own."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from nlos.acquisition.served.server import SampleServer


@contextmanager
def serving(run: Path, port: int = 0, *ended_by: type[Exception]) -> Iterator[SampleServer]:
    """Until the block ends, or one of these errors."""
    server = SampleServer(run, port=port)
    stop = threading.Event()

    def serve() -> None:
        with suppress(*ended_by):
            server.serve(lambda: not stop.is_set())

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield server
    finally:
        stop.set()
        thread.join()
        server.close()
