"""The picture of a recording that a verb makes as well: RUN/ beside RUN.h5, looked at before any light."""

from pathlib import Path

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
