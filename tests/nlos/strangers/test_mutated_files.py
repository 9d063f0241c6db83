"""Files damaged at random, of every kind, given to every verb that reads them: an exit code with a reason, no hang."""

import json
import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.damaged import mutated

CAMPAIGN, PARTS = (20_000, 80) if os.environ.get("NLOS_SOAK") else (60, 2)
REPORT = os.environ.get("NLOS_MUTATED_REPORT")


@pytest.mark.soak
@pytest.mark.parametrize("part", range(PARTS))
def test_a_damaged_file_is_an_exit_code_with_a_reason(kinds, verbs, commands, tmp_path: Path, part: int) -> None:
    wholes = [(kind, np.frombuffer(path.read_bytes(), np.uint8), path) for kind, path in kinds.items()]
    bad, table = [], Counter()
    for seed in range(part, CAMPAIGN, PARTS):
        kind, whole, path = wholes[(seed // 2) % len(wholes)]
        words = verbs(kind)[(seed // 2 // len(wholes)) % len(verbs(kind))]
        damaged = tmp_path / f"damaged{path.suffix}"
        damaged.write_bytes(mutated(whole, seed))
        outcome = commands.run([*words, damaged.name])
        table[kind, words[0], outcome.code] += 1
        unnamed = outcome.code == 7 and damaged.stem not in outcome.text
        if outcome.is_a_bug or unnamed:
            bad.append((seed, kind, outcome))
            print(seed, kind, outcome, flush=True)
        damaged.unlink(missing_ok=True)
    if REPORT:
        rows = [[*key, count] for key, count in sorted(table.items())]
        Path(f"{REPORT}.{part}.json").write_text(json.dumps(rows))
    assert bad == []
