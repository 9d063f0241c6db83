"""`reconstruct --follow`: results in a folder, replaced as they sharpen while the scan is being written."""

import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.disk_refusal import told_of
from nlos.cli.terminal import terminal
from nlos.live.scan import LiveScan
from nlos.recipe import Recipe
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.recon.parts import counted
from nlos.recon.results import NAMES, write_reconstruction
from nlos.recon.view3d import write_view3d
from nlos.results_folder import ResultsFolder
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.recon.volume import Reconstruction


def follow_to_folder(
    run: Path,
    recipe: Recipe,
    results: ResultsFolder,
) -> "LiveScan":
    """Follows `run`, or what a ticket says, until the scan ends; the last result is that of the finished recording.
    confidence.png beside it also says where the picture still changed; `results.html` adds view3d.html at the end.

    Raises FileExistsError as `results` says, and what following raises.
    """
    live = LiveReconstruction(recipe.method, recipe.settings, recipe.device)
    results.check()
    folder = results.path
    if run.suffix == ".ticket":
        from nlos.acquisition.served.ticket import Ticket  # needs the extra `live`

        Ticket.load(run)
    folder.mkdir(parents=True, exist_ok=True)

    writing = threading.Lock()

    def keep(picture: "LivePicture") -> None:
        with writing:
            replace_numbers(folder, picture.reconstruction, results.volume)
            bound = "" if picture.bound is None else f"error below {picture.bound:.3f}, "
            terminal.log(
                f"{picture.samples} points: change {picture.change:.3f}, photon noise {picture.error:.3f}, {bound}"
                f"{picture.reconstruction.seconds:.2f} s"
            )

    def keep_explained(picture: "LivePicture") -> None:
        with writing:
            replace_numbers(folder, picture.reconstruction, results.volume)
            replace_pictures(folder, picture, results.volume)

    with local_copy(run, folder) as local:
        scan = LiveScan(
            local, [live], recipe.constants, on_picture=keep, on_explained=keep_explained, response=recipe.response,
            adds_up=True,
        )  # fmt: skip
        scan.start()
        try:
            scan.wait()
        finally:
            writing.acquire()  # what is being written is written; nobody waits for the painter, which writes no more
    if results.html and scan.picture is not None:
        with whole_file(folder / "view3d.html") as partial:
            write_view3d(partial, scan.picture.reconstruction)
    return scan


def replace_numbers(folder: Path, reconstruction: "Reconstruction", keep_volume: bool) -> None:
    """reconstruction.h5, written beside and put in place: no reader meets half a file, or waits for drawing."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".next-") as fresh, told_of(folder, Path(fresh)):
        data = Path(fresh) / NAMES[0]
        write_reconstruction(data, reconstruction, keep_volume)
        data.replace(folder / data.name)


def replace_pictures(folder: Path, picture: "LivePicture", keep_volume: bool) -> None:
    """The pictures, in the same way."""
    from nlos.recon.pictures import albedo_picture, confidence_picture, depth_picture
    from nlos.recon.slices_picture import slices_picture
    from nlos.recon.uncertainty_picture import uncertainty_picture

    result = picture.reconstruction
    draw = [(albedo_picture, NAMES[1]), (depth_picture, NAMES[2])]
    if keep_volume and result.volume is not None:
        draw.append((slices_picture, "slices.png"))
    if result.intervals is not None:
        draw.append((uncertainty_picture, "uncertainty.png"))
    with tempfile.TemporaryDirectory(dir=folder, prefix=".next-") as fresh, told_of(folder, Path(fresh)):
        for drawn, name in counted(draw, len(draw), "pictures"):
            drawn(result, Path(fresh) / name)
        confidence_picture(replace(result, confidence=picture.confidence), Path(fresh) / "confidence.png")
        for image in Path(fresh).iterdir():
            image.replace(folder / image.name)


@contextmanager
def local_copy(run: Path, folder: Path) -> Iterator[Path]:
    """The recording itself; of a ticket, a copy in `folder` that grows as the served one does."""
    if run.suffix != ".ticket":
        yield run
        return
    from nlos.acquisition.served.far_copy import FarCopy  # needs the extra `live`

    local = folder / run.with_suffix(".h5").name
    with FarCopy(run, local) as copy:
        try:
            yield local
        except StorageError:
            copy.check()  # where the copy itself broke off, that is the reason
            raise
        copy.check()
