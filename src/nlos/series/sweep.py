"""`nlos scan --sweep KEY=A,B,C`: a series made from one scan, written down as a queue file, which can be resumed."""

import contextlib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.cli.exit_codes import UsageError
from nlos.cli.taking import ScanOptions
from nlos.cli.terminal import terminal
from nlos.configs.load import Loaded, load
from nlos.drivers.bench_settings import BenchSettings
from nlos.run_defaults import dated_name
from nlos.series import journal
from nlos.series.carry_out import Series, carry_out
from nlos.series.settings import QueueSettings
from nlos.whole_file import whole_file
from nlos.writable import check_writable


def swept(
    scan: Loaded[ScanSettings],
    bench: Loaded[BenchSettings],
    sweep: Sequence[str],
    options: ScanOptions,
    output: Path | None,
    no_shutter: bool,
) -> int:
    """Writes FOLDER/queue.yaml and carries it out; over the same file it resumes. Returns the exit code."""
    notes, constants = options.notes, options.constants
    folder = output or dated_name(bench.settings, f"{scan.path.stem}-sweep", notes.sample, datetime.now()).with_suffix(
        ""
    )
    content: dict[str, Any] = {
        "bench": str(bench.path.absolute()),
        "folder": ".",
        **{key: value for key, value in (("reconstruct", options.method), ("sample", notes.sample),
                                         ("note", notes.note), ("operator", notes.operator)) if value is not None},
        "tags": list(notes.tags),
        "no_shutter": no_shutter,
        "runs": [{"scan": str(scan.path.absolute()), "sweep": _keys(sweep)}],
    }  # fmt: skip
    if constants is not None:
        content["constants"] = str(constants if str(constants) == "none" else constants.absolute())
    text = f"# Written by `nlos scan --sweep`; `nlos queue` of this file resumes it.\n{yaml.safe_dump(content)}"
    target = folder / "queue.yaml"
    check_writable(folder)
    own, fresh = not folder.exists(), not target.exists()
    folder.mkdir(parents=True, exist_ok=True)
    if fresh:
        with whole_file(target) as partial:  # half of one would be another series, for ever
            partial.write_bytes(text.encode())
    elif target.read_bytes() != text.encode():
        raise FileExistsError(f"{target}: is another series. Choose another folder with -o.")
    series = None
    try:
        series = Series.of(load_queue(target))
        terminal.log(f"{target}: `nlos queue {target}` resumes it after anything")
        return carry_out(series)
    finally:
        begun = series is not None and any(series.recording(run).exists() for run in series.runs)
        if fresh and not begun and not (folder / journal.NAME).exists():
            for name in (target, folder / journal.PLAN):
                name.unlink(missing_ok=True)  # nothing was begun: it must not stand in the way of what was meant
            if series is not None:
                terminal.log(f"{target}: nothing was begun, so it is gone again")
            if own:
                with contextlib.suppress(OSError):
                    folder.rmdir()


def load_queue(path: Path) -> Loaded[QueueSettings]:
    """A queue file. Raises `ConfigError` with its line, `FileNotFoundError`."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such queue file")
    return load("queue", str(path), QueueSettings)


def _keys(sweep: Sequence[str]) -> dict[str, list[Any]]:
    """Which values each key takes. Raises `UsageError`."""
    keys: dict[str, list[Any]] = {}
    for key, values in map(_values, sweep):
        if key in keys:
            raise UsageError(f"--sweep {key}: given twice. Name all of its values at once, as {key}=A,B,C.")
        keys[key] = values
    return keys


def _values(text: str) -> tuple[str, list[Any]]:
    """KEY=A,B,C as YAML reads each value."""
    key, _, values = text.partition("=")
    if not (key and values):
        raise UsageError(f"--sweep {text}: write KEY=A,B,C")
    try:
        found = [yaml.safe_load(each) for each in values.split(",")]
    except yaml.YAMLError:
        found = [None]
    if not all(isinstance(each, bool | int | float | str) for each in found):
        raise UsageError(f"--sweep {text}: each value must be a number or a word")
    return key, found
