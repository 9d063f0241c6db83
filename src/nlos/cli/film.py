"""What `nlos reconstruct --film` and `nlos export --to gif,mp4` share: a recording's frames, one after the other."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.read_by_child import open_checked
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.recipe import Recipe
    from nlos.results_folder import ResultsFolder


@contextmanager
def frames_counted(run: Path) -> Iterator[Callable[[int], None]]:
    """What to tell of every frame that is done, as `film_of` does, to see them counted on the terminal."""
    with open_checked(run) as recording:
        frames = recording.plan.frames
    with Progress(frames, what="film", unit="frames") as progress:

        def counted(count: int) -> None:
            progress.going_to(count)
            progress.step()

        yield counted


def reconstruct_film(
    run: Path,
    recipe: "Recipe",
    results: "ResultsFolder",
    *,
    window: int | None,
    memory: bool,
    skip_existing: bool,
) -> None:
    """The film and its track into the folder of results. Raises `FileExistsError`."""
    from nlos.film import NAMES, film_of, made_of, write_film

    output = results.path
    if skip_existing and all((output / name).exists() for name in NAMES):
        made = made_of(output)
        if made is not None and made != (recipe.method, memory):
            kinds = (
                f"{method}{' with a memory' if moved else ''}" for method, moved in (made, (recipe.method, memory))
            )
            raise FileExistsError(
                f"{output}: --skip-existing: holds a film by {', not by '.join(kinds)}. Choose another folder, or use "
                "--overwrite."
            )
        terminal.result(f"{output}: already exists, skipped", folder=str(output), files=[], pictures=0)
        return
    if not skip_existing:
        results.check(NAMES)
    with frames_counted(run) as counted:
        film = film_of(run, recipe, window, counted, memory)
    paths = write_film(output, film, new=not (results.overwrite or skip_existing))
    terminal.result(
        f"{output}: {', '.join(path.name for path in paths)} ({recipe.method}, {len(film.frame)} pictures)",
        folder=str(output), files=[path.name for path in paths], pictures=len(film.frame), window=film.window,
    )  # fmt: skip
    terminal.result(f"response: {film.response}", response=film.response)
    known = [one.share for one in film.explained if one.share is not None]
    nothing = sum(one.nothing for one in film.explained)
    if known:
        median = sorted(known)[len(known) // 2]
        terminal.result(
            f"explains {100 * median:.0f} % of the light, in the median of its pictures", explained=round(median, 4)
        )
    if nothing:
        terminal.log(
            f"{output}: WARNING: {nothing} of {len(film.frame)} pictures explain nothing: do not believe them", -1
        )
