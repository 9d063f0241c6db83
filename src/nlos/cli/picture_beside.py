"""The picture of a recording that a verb makes as well: RUN/ beside RUN.h5, looked at before any light."""

from pathlib import Path

from nlos.cli.terminal import terminal
from nlos.recon.errors import InvalidData
from nlos.recon.own_methods import name_of
from nlos.recon.results import read_reconstruction
from nlos.results_folder import ResultsFolder


def picture_beside(run: Path, overwrite: bool, remedy: str) -> ResultsFolder:
    """Where the picture of `run` goes. Raises `FileExistsError` where another one is there and may not be replaced,
    with `remedy`, and as `ResultsFolder.check` does."""
    results = ResultsFolder(run.with_suffix(""), overwrite=overwrite)
    try:
        results.check()
    except FileExistsError as error:
        raise FileExistsError(f"{results.path}: holds a picture, where that of {run} would go. {remedy}") from error
    return results


def picture_kept(run: Path, method: str) -> bool:
    """Whether RUN/ is there and is kept; that it holds no picture by `method` is said."""
    folder, wanted = run.with_suffix(""), name_of(method)
    if not folder.exists():
        return False
    try:
        made = read_reconstruction(folder / "reconstruction.h5").method
    except (InvalidData, OSError):
        made = ""
    if made != wanted:
        holds = f"a picture by {made}" if made else "no picture"
        terminal.log(
            f"warning: {folder}: is there and holds {holds}, so none by {wanted} was made: "
            f"`nlos reconstruct {run} --method {method} -o DIR` makes it"
        )
    return True
