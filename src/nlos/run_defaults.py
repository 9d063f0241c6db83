"""Notes and places of a run: what the command line says, else the bench file, else a person's own defaults."""

import os
from collections.abc import Sequence
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.run_notes import RunNotes
from nlos.cli.exit_codes import UsageError
from nlos.configs.load import ConfigError, parse
from nlos.configs.read_whole import read_whole
from nlos.drivers.file_word import cut, file_word
from nlos.drivers.run_defaults import HookSettings, RunDefaults
from nlos.drivers.state_folder import home_folder

if TYPE_CHECKING:
    from nlos.drivers.bench_settings import BenchSettings

CONFIG = "NLOS_CONFIG"
"""Environment variable: the folder of a person's own defaults; `~/.config/nlos` where it is not set."""
LONGEST_NAME = 120
"""Bytes of what a run is called, its time and number aside."""


def own_defaults() -> RunDefaults:
    """`defaults.yaml` in that folder; nothing where there is none. Raises as `configs.load.load`."""
    try:
        path = Path(os.environ.get(CONFIG) or home_folder() / ".config" / "nlos") / "defaults.yaml"
        text = read_whole(path).decode("utf-8")
    except FileNotFoundError:  # whoever has no home has no defaults either
        return RunDefaults()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    return parse(text, str(path), RunDefaults)


def notes_for(
    bench: "BenchSettings", sample: str | None, operator: str | None, note: str | None, tags: Sequence[str]
) -> RunNotes:
    """Raises `UsageError` for what a recording does not keep."""
    own, its = own_defaults(), bench.runs
    words = [tag for given in tags for tag in given.split(",")]
    try:
        return RunNotes.of(
            _first(sample, its.sample, own.sample),
            _first(operator, its.operator, own.operator),
            _first(note, its.note, own.note),
            [*words, *its.tags, *own.tags],
        )
    except ValueError as error:
        raise UsageError(str(error)) from error


def _first(given: str | None, *defaults: str) -> str:
    """What was given, an empty text too; else the first default that says something."""
    return given if given is not None else next((text for text in defaults if text), "")


def hooks_for(bench: "BenchSettings") -> HookSettings:
    """The bench's, else one's own."""
    return bench.runs.hooks or own_defaults().hooks


def data_folder(bench: "BenchSettings | None" = None) -> Path | None:
    """Where runs are kept; None: nobody said, so in the current folder."""
    said = (bench.runs.folder if bench is not None else "") or own_defaults().folder
    return expanded(said) if said else None


def dated_name(bench: "BenchSettings", scan: str, sample: str, now: datetime) -> Path:
    """What a scan without a name of its own is called: day, time, scan and sample, in the data folder by days. A time
    that comes twice, as clocks are set back, is numbered."""
    folder, said = data_folder(bench), "-".join(word for word in (file_word(scan), file_word(sample)) if word)
    words = cut(said, LONGEST_NAME)
    if folder is None:
        name = Path(f"{words}-{now:%Y%m%d-%H%M%S}.h5")
    else:
        name = folder / f"{now:%Y-%m-%d}" / f"{now:%H%M%S}-{words}.h5"
    names = chain([name], (name.with_stem(f"{name.stem}-{number}") for number in count(2)))
    return next(each for each in names if not (os.path.lexists(each) or each.with_suffix("").exists()))


def expanded(path: str) -> Path:
    """`path` with `~` and `~user` replaced. Raises `UsageError` where there is no such user, or no home."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise UsageError(
            f"{path}: {path.partition('/')[0]} has no home folder on this computer. Write the whole path."
        ) from None
