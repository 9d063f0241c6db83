"""Many recordings on a Dask cluster: each result as on one machine, taken up by another worker where one dies.

Workers reach the recordings and the folders of results by the same paths. Dask trusts whoever reaches its scheduler:
that port belongs on loopback or a private network.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from distributed import Client

RETRIES = 3


def reconstruct_on(
    address: str,
    jobs: Sequence[tuple[Path, Path]],
    method: str,
    settings: dict[str, object],
    *,
    constants: Path | None = None,
    overwrite: bool = False,
    **options: Any,
) -> list[float]:
    """Reconstructs every (recording, folder) on the workers of `address`; returns the seconds of each, in order.

    Raises FileExistsError unless `overwrite` before anything starts, `Stopped` where no scheduler answers, and what
    the first failing recording raised, after the others are done.
    """
    from distributed import as_completed

    from nlos.recon.results import NAMES

    for _, folder in jobs:
        for name in NAMES:
            if (folder / name).exists() and not overwrite:
                raise FileExistsError(f"{folder / name}: exists. Choose another folder with -o, or say --overwrite.")
    given = None if constants is None else constants.resolve()
    with connected(address) as client:
        # A task that begins again after its worker died may find files of the first attempt: it replaces them.
        futures = [
            client.submit(
                reconstruct_one, run.resolve(), folder.resolve(), method, settings, given, options,
                pure=False, retries=RETRIES,
            )
            for run, folder in jobs
        ]  # fmt: skip
        for done, _ in enumerate(as_completed(futures), 1):
            terminal.log(f"{done} of {len(jobs)} recordings")
        return [float(future.result()) for future in futures]


def reconstruct_one(
    run: Path, folder: Path, method: str, settings: dict[str, object], constants: Path | None, options: dict[str, Any]
) -> float:
    """What a worker does with one recording; returns the seconds that the method took."""
    from nlos.chain import reconstruct_file

    return reconstruct_file(run, method, settings, folder, constants=constants, overwrite=True, **options).seconds


@contextmanager
def connected(address: str) -> Iterator["Client"]:
    """A client of the scheduler at `address`; `local` starts one worker process a core. Raises `Stopped`."""
    from distributed import Client, LocalCluster

    if address == "local":
        with LocalCluster(threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise Stopped(ExitCode.DEADLINE, f"--scheduler {address}: no Dask scheduler answers ({error})") from error
    with client:
        yield client
