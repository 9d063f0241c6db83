"""Files damaged at random, of every kind, given to every verb that reads them: an exit code with a reason, no hang, and
no sample of a damaged recording that is not the one that was measured."""

import json
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording
from tests.damaged import mutated
from tests.nlos.strangers.conftest import CommandProcess
from tests.nlos.strangers.damaged_cases import Pair, pairs
from tests.nlos.strangers.kinds_of_files import KEPT, laid
from tests.nlos.strangers.outcome_table import TABLE, read_table

SOAK = bool(os.environ.get("NLOS_SOAK"))
CAMPAIGN, PARTS = (20_000, 40) if SOAK else (60, 2)
KEPT_CASES, KEPT_PARTS = (1200, 3) if SOAK else (18, 1)
REPORT = os.environ.get("NLOS_MUTATED_REPORT")
COPIES = {"recover": "new.h5", "replay": "new.h5", "verify": None}
"""Verbs that vouch for samples, and where they put them: None, where they were."""


def measured(path: Path) -> dict[int, bytes]:
    """Point number -> its counts and place."""
    with Recording.open(path) as recording:
        return {
            sample.point.number: sample.histogram.counts.tobytes()
            + np.float64([sample.point.x_m, sample.point.y_m]).tobytes()
            for sample in recording.samples()
        }


def test_undamaged_every_kind_of_file_is_read_by_some_verb(kinds, verbs, commands) -> None:
    """Otherwise damage would never be met."""
    refused = {
        kind: [outcome.text for words in verbs(kind) if (outcome := commands.run([*words, path.name])).code != 0]
        for kind, path in kinds.items()
        if kind not in KEPT
        if not any(commands.run([*words, path.name]).code == 0 for words in verbs(kind))
    }
    assert refused == {}


@pytest.mark.soak
@pytest.mark.parametrize("part", range(PARTS))
def test_a_damaged_file_is_an_exit_code_with_a_reason(kinds, verbs, commands, tmp_path: Path, part: int) -> None:
    seeds = range(part * CAMPAIGN // PARTS, (part + 1) * CAMPAIGN // PARTS)
    assert run_cases(kinds, commands, tmp_path, pairs(), seeds, str(part)) == []


@pytest.mark.soak
@pytest.mark.parametrize("part", range(KEPT_PARTS))
def test_a_damaged_ticket_is_called_nowhere_and_a_damaged_index_is_made_anew(
    kinds, commands, tmp_path: Path, part: int
) -> None:
    each = KEPT_CASES // KEPT_PARTS
    seeds = range(20_000 + part * each, 20_000 + (part + 1) * each)
    assert run_cases(kinds, commands, tmp_path, pairs(KEPT), seeds, f"kept{part}") == []


def run_cases(
    kinds: Mapping[str, Path], commands: CommandProcess, folder: Path, turns: list[Pair], seeds: range, report: str
) -> list[tuple[object, ...]]:
    """The cases that did not end as they must; a table of all beside, where one is asked for."""
    table: Counter[tuple[str, str, int]] = Counter()
    bad, known, whole = [], read_table(TABLE.read_text()), {kind: path.read_bytes() for kind, path in kinds.items()}
    undamaged = {words: commands.run(words).text for kind, words in set(turns) if kind == "runs_index"}
    for seed in seeds:
        kind, words = turns[seed % len(turns)]
        if kind not in kinds:
            continue
        path, good = kinds[kind], whole[kind]
        if (raw := mutated(np.frombuffer(good, np.uint8), seed)) == good:
            continue
        outcome = commands.run(laid(folder, kind, path, words, raw))
        table[kind, words[0], outcome.code] += 1
        wrong = []
        if outcome.is_a_bug:
            wrong.append("a bug")
        if outcome.code == 7 and "damaged" not in outcome.text:
            wrong.append("the file is not named")
        if outcome.code == 0 and words[0] in COPIES and "recording" in kind:
            vouched = measured(folder / (COPIES[words[0]] or f"damaged{path.suffix}"))
            wrong += [f"sample {n}" for n, row in vouched.items() if measured(path).get(n) != row]
        if kind == "runs_index" and (outcome.code, outcome.text) != (0, undamaged[words]):
            wrong.append("it does not say what the files do")
        if not SOAK and outcome.code not in known[kind, words[0]]:
            wrong.append(f"{outcome.code} is not in {TABLE.name}: run the campaign again")
        if wrong:
            bad.append((seed, kind, wrong, outcome))
            print(seed, kind, wrong, outcome, flush=True)
        for left in (f"damaged{path.suffix}", "good.ticket"):
            (folder / left).unlink(missing_ok=True)
    if REPORT:
        Path(f"{REPORT}.{report}.json").write_text(json.dumps([[*key, count] for key, count in sorted(table.items())]))
    return bad
