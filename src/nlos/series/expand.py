"""A queue file as the scans that it asks for: each with its own settings, name and notes, checked before the first."""

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from nlos.acquisition.planning.scan_settings import UNTIL_STOPPED, ScanSettings
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.cli.exit_codes import UsageError
from nlos.configs.load import Loaded, find, load, parse
from nlos.configs.read_whole import read_whole
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.file_word import cut, file_word
from nlos.run_defaults import notes_for
from nlos.series.settings import MOST_RUNS, QueuedScan, QueueSettings

LONGEST_NAME = 120
"""Bytes of a run's name."""


@dataclass(frozen=True)
class Run:
    """One scan of a series."""

    name: str
    """Of its recording, without `.h5`: its number, scan, and what is special about it."""
    scan: Loaded[ScanSettings]
    bench: Loaded[BenchSettings]
    notes: RunNotes

    @cached_property
    def digest(self) -> str:
        """Of what is measured and on which bench, alarms aside: two runs of one name and digest are the same run."""
        words = f"{self.scan.settings.plan().digest()}\n{self.bench.settings.name}"
        return hashlib.sha256(words.encode()).hexdigest()[:16]


def expand(queue: Loaded[QueueSettings]) -> list[Run]:
    """Raises `ConfigError` naming the entry, for everything that no scan could be."""
    settings, beside = queue.settings, queue.path.parent
    asked = [(entry, *each) for entry in settings.runs for each in _variants(entry)]
    if len(asked) > MOST_RUNS:
        raise UsageError(f"{queue.path}: asks for {len(asked)} scans; {MOST_RUNS} at most")
    digits, benches, runs = len(str(len(asked))), dict[str, Loaded[BenchSettings]](), []
    for number, (entry, changes, again) in enumerate(asked, start=1):
        word = _beside(beside, entry.bench or settings.bench)
        bench = benches.setdefault(word, load("bench", word, BenchSettings))
        scan = changed(_beside(beside, entry.scan), {**entry.set, **changes})
        if scan.settings.frames == UNTIL_STOPPED:
            raise UsageError(
                f"{queue.path}: {scan.path} goes on until it is stopped, and nobody stops the scans of a series. Say "
                "how many frames there are: `set: {frames: 100}`, or --sweep frames=100."
            )
        notes = notes_for(
            bench.settings,
            _either(entry.sample, settings.sample),
            _either(entry.operator, settings.operator),
            _either(entry.note, settings.note),
            [*entry.tags, *settings.tags],
        )
        special = [f"{key.rpartition('.')[2]}-{value}" for key, value in changes.items()]
        words = [scan.path.stem, *special, notes.sample, f"again-{again}" if again > 1 else ""]
        name = "-".join([f"{number:0{digits}d}", *(file_word(str(each)) for each in words if each)])
        runs.append(Run(cut(name, LONGEST_NAME), scan, bench, notes))
    return runs


def _variants(entry: QueuedScan) -> Iterator[tuple[dict[str, Any], int]]:
    """(keys changed, which repetition) of every scan that an entry asks for."""
    for values in itertools.product(*entry.sweep.values()):
        for again in range(1, entry.repeat + 1):
            yield dict(zip(entry.sweep, values, strict=True)), again


def changed(word: str, changes: Mapping[str, Any]) -> Loaded[ScanSettings]:
    """A scan file with other values at dotted keys. Raises `ConfigError` as if they were in it."""
    if not changes:
        return load("scan", word, ScanSettings)
    path = find("scan", word)
    load("scan", word, ScanSettings)  # what is wrong with the file itself is said first, with its lines
    content: dict[str, Any] = yaml.safe_load(read_whole(path).decode("utf-8"))
    for key, value in changes.items():
        *blocks, last = key.split(".")
        block = content
        for each in blocks:
            inner = block.setdefault(each, {})
            if not isinstance(inner, dict):
                inner = block[each] = {"kind": inner}  # `pattern: serpentine` is short for a block
            block = inner
        block[last] = value
    said = ", ".join(f"{key}={value}" for key, value in changes.items())
    text = f"# {path.name} with {said}\n{yaml.safe_dump(content, sort_keys=False)}"
    return Loaded(parse(text, f"{path} with {said}", ScanSettings), path, text)


def _beside(folder: Path, word: str) -> str:
    """A file beside the queue file where there is one, else what the command line would make of the word."""
    return str(folder / word) if (folder / word).is_file() else word


def _either(given: str | None, default: str | None) -> str | None:
    return given if given is not None else default
