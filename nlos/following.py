"""`reconstruct --follow`: results in a folder, replaced as they sharpen while the scan is being written."""

import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.terminal import terminal

if TYPE_CHECKING:
    from nlos.live_scan import LiveScan
    from recon.live import LivePicture
    from recon.volume import Reconstruction


def follow_to_folder(
    run: Path,
    method: str,
    settings: dict[str, object],
    folder: Path,
    *,
    constants: Path | None = None,
    device: str = "cpu",
    volume: bool = True,
    overwrite: bool = False,
) -> "LiveScan":
    """Follows `run`, or what a ticket says, until the scan ends; the last result is that of the finished recording.

    Raises FileExistsError unless `overwrite`, and what following raises.
    """
    from nlos.live_scan import LiveScan
    from recon.live import LiveReconstruction
    from recon.results import NAMES

    for name in NAMES:
        if (folder / name).exists() and not overwrite:
            raise FileExistsError(f"{folder / name}: exists. Choose another folder with -o, or say --overwrite.")
    folder.mkdir(parents=True, exist_ok=True)

    def keep(picture: "LivePicture") -> None:
        replace_results(folder, picture.reconstruction, volume)
        terminal.log(
            f"{picture.samples} points: change {picture.change:.3f}, photon noise {picture.error:.3f}, "
            f"{picture.reconstruction.seconds:.2f} s{', refined' if scan.live.refines and picture.refined else ''}"
        )

    with local_copy(run, folder) as local:
        scan = LiveScan(local, LiveReconstruction(method, settings, device), constants, on_picture=keep)
        scan.start()
        scan.wait()
    return scan


def replace_results(folder: Path, reconstruction: "Reconstruction", keep_volume: bool) -> None:
    """Writes results beside `folder`'s own and puts them in place one by one, numbers before pictures: no reader meets
    half a file, or waits for drawing."""
    from recon.pictures import albedo_picture, depth_picture, slices_picture
    from recon.results import NAMES, write_reconstruction

    with tempfile.TemporaryDirectory(dir=folder, prefix=".next-") as fresh:
        data, albedo, depth = (Path(fresh) / name for name in NAMES)
        write_reconstruction(data, reconstruction, keep_volume)
        data.replace(folder / data.name)
        draw = [(albedo_picture, albedo), (depth_picture, depth)]
        if keep_volume and reconstruction.volume is not None:
            draw.append((slices_picture, Path(fresh) / "slices.png"))
        for picture, path in draw:
            picture(reconstruction, path)
            path.replace(folder / path.name)


@contextmanager
def local_copy(run: Path, folder: Path) -> Iterator[Path]:
    """The recording itself; of a ticket, a copy in `folder` that grows as the served one does."""
    if run.suffix != ".ticket":
        yield run
        return
    from acquisition.network.mirror import mirror
    from acquisition.network.ticket import Ticket

    local = folder / run.with_suffix(".h5").name
    ticket = Ticket.load(run)
    failed: list[Exception] = []

    def copy() -> None:
        from acquisition.errors import InvalidData, StorageError

        try:
            mirror(ticket, local)
        except (InvalidData, StorageError, TimeoutError) as error:
            failed.append(error)
            terminal.log(f"{run}: {error}", -1)

    thread = threading.Thread(target=copy, daemon=True)
    thread.start()
    yield local
    thread.join(5.0)
    if failed:
        raise failed[0]
