"""Files damaged at random, of every kind, given to every verb that reads them: an exit code with a reason, no hang, and
no sample of a damaged recording that is not the one that was measured."""

import json
import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording
from tests.damaged import mutated
from tests.nlos.strangers.damaged_cases import pairs
from tests.nlos.strangers.outcome_table import TABLE, read_table

SOAK = bool(os.environ.get("NLOS_SOAK"))
CAMPAIGN, PARTS = (20_000, 40) if SOAK else (60, 2)
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
        if not any(commands.run([*words, path.name]).code == 0 for words in verbs(kind))
    }
    assert refused == {}


@pytest.mark.soak
@pytest.mark.parametrize("part", range(PARTS))
def test_a_damaged_file_is_an_exit_code_with_a_reason(kinds, verbs, commands, tmp_path: Path, part: int) -> None:
    turns, bad, table, known = pairs(), [], Counter(), read_table(TABLE.read_text())
    for seed in range(part * CAMPAIGN // PARTS, (part + 1) * CAMPAIGN // PARTS):
        kind, words = turns[seed % len(turns)]
        if kind not in kinds:
            continue
        path = kinds[kind]
        damaged = tmp_path / f"damaged{path.suffix}"
        damaged.write_bytes(mutated(np.frombuffer(path.read_bytes(), np.uint8), seed))
        outcome = commands.run([*words, damaged.name])
        table[kind, words[0], outcome.code] += 1
        wrong = []
        if outcome.is_a_bug:
            wrong.append("a bug")
        if outcome.code == 7 and damaged.stem not in outcome.text:
            wrong.append("the file is not named")
        if outcome.code == 0 and words[0] in COPIES and "recording" in kind:
            vouched = measured(tmp_path / (COPIES[words[0]] or damaged.name))
            wrong += [f"sample {n}" for n, row in vouched.items() if measured(path).get(n) != row]
        if not SOAK and outcome.code not in known[kind, words[0]]:
            wrong.append(f"{outcome.code} is not in {TABLE.name}: run the campaign again")
        if wrong:
            bad.append((seed, kind, wrong, outcome))
            print(seed, kind, wrong, outcome, flush=True)
        damaged.unlink(missing_ok=True)
    if REPORT:
        Path(f"{REPORT}.{part}.json").write_text(json.dumps([[*key, count] for key, count in sorted(table.items())]))
    assert bad == []
