"""What `nlos reconstruct --film` and `nlos export --to gif,mp4` share: a recording's frames, one after the other."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from nlos.acquisition.recording.checked import open_checked
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal


@contextmanager
def frames_counted(run: Path) -> Iterator[Callable[[int], None]]:
    """What to tell of every frame that is done, as `film_of` does, to see them counted on the terminal."""
    with open_checked(run) as recording:
        frames = recording.plan.frames
    with Progress(frames, what="film", unit="frames") as progress:
        yield lambda count: progress.step()


def reconstruct_film(
    run: Path,
    method: str,
    settings: Mapping[str, object],
    output: Path,
    window: int | None,
    constants: Path | None,
    response: str,
    device: str,
    overwrite: bool,
    skip_existing: bool,
    memory: bool,
) -> None:
    """The film and its track into the folder `output`. Raises `FileExistsError`."""
    from nlos.film import NAMES, film_of, write_film
    from nlos.response import response_wanted

    if skip_existing and all((output / name).exists() for name in NAMES):
        terminal.result(f"{output}: already exists, skipped", folder=str(output), files=[], pictures=0)
        return
    for name in NAMES:
        if (output / name).exists() and not (overwrite or skip_existing):
            raise FileExistsError(f"{output / name}: exists. Choose another folder with -o, or use --overwrite.")
    with frames_counted(run) as counted:
        film = film_of(run, method, settings, window, constants, response_wanted(response), device, counted, memory)
    paths = write_film(output, film)
    terminal.result(
        f"{output}: {', '.join(path.name for path in paths)} ({method}, {len(film.frame)} pictures)",
        folder=str(output), files=[path.name for path in paths], pictures=len(film.frame), window=film.window,
    )  # fmt: skip
    terminal.result(f"response: {film.response}", response=film.response)
