"""What `nlos reconstruct --film` and `nlos export --to gif,mp4` share: a recording's frames, one after the other."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.film import Film


def film_with_progress(
    run: Path,
    method: str,
    settings: Mapping[str, object],
    window: int | None = None,
    constants: Path | None = None,
    device: str = "cpu",
) -> "Film":
    """`film_of`, with the frames counted on the terminal."""
    from nlos.acquisition.recording.checked import open_checked
    from nlos.film import film_of

    with open_checked(run) as recording:
        frames = recording.plan.frames
    with Progress(frames, what="film", unit="frames") as progress:
        return film_of(run, method, settings, window, constants, device, lambda count: progress.step())


def reconstruct_film(
    run: Path,
    method: str,
    settings: Mapping[str, object],
    output: Path,
    window: int | None,
    constants: Path | None,
    device: str,
    overwrite: bool,
) -> None:
    """The film and its track into the folder `output`. Raises `FileExistsError`."""
    from nlos.film import NAMES, write_film

    for name in NAMES:
        if (output / name).exists() and not overwrite:
            raise FileExistsError(f"{output / name}: exists. Choose another folder with -o, or use --overwrite.")
    film = film_with_progress(run, method, settings, window, constants, device)
    paths = write_film(output, film)
    terminal.result(
        f"{output}: {', '.join(path.name for path in paths)} ({method}, {len(film.frame)} pictures)",
        folder=str(output), files=[path.name for path in paths], pictures=len(film.frame), window=film.window,
    )  # fmt: skip
