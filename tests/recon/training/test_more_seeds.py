"""More seeds of two rows: judged as the rows are, mirror images by the same weights; errors over what is there."""

import json
from pathlib import Path

import numpy as np
import pytest

from studies import more_seeds, rows
from studies.judged import FIGURES
from studies.more_seeds import MORE, SHIPS, WITHOUT, mirrored_of, run, written
from studies.rows import JUDGED, SEEDS, TABLES, folder_of, kept_of


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(rows, "FOLDER", tmp_path / "runs")
    monkeypatch.setattr(rows, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(more_seeds, "KEPT", tmp_path / "kept")
    return tmp_path


def test_both_are_rows_of_the_ablations_and_the_seeds_are_new() -> None:
    known = {folder_of(row, 100, 1) for table in TABLES.values() for row in table}
    assert {folder_of(row, 100, 1) for row in (SHIPS, WITHOUT)} < known
    assert not set(MORE) & set(SEEDS)


def test_the_same_weights_are_judged_once_and_mirrored(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = {"rows": 8, "cols": 8, "bins": 32, "bin_width_ps": 512.0}
    monkeypatch.setattr(rows, "SMALL", tiny)
    monkeypatch.setattr(rows, "WATCHED", rows.WATCHED.model_copy(update=tiny | {"scenes": 1}))
    small = {name: data.model_copy(update=tiny | {"scenes": 2}) for name, data in JUDGED.items()}
    monkeypatch.setattr(more_seeds, "JUDGED", small)
    run(1, (4,))
    once, mirrored = (json.loads(path.read_text()) for path in (kept_of(SHIPS, 1, 4), mirrored_of(1, 4)))
    assert once.keys() == mirrored.keys() == JUDGED.keys()
    assert once != mirrored
    assert kept_of(WITHOUT, 1, 4).exists()
    assert len(list((elsewhere / "runs").rglob("weights.safetensors"))) == 2
    times = {path: path.stat().st_mtime_ns for path in (elsewhere / "kept").rglob("*.json")}
    assert len(times) == 3
    run(1, (4,))
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_the_table_has_first_new_and_all_seeds(elsewhere: Path) -> None:
    def put(path: Path, value: float) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        scenes = (value + 0.001 * np.arange(4)).round(5).tolist()
        path.write_text(json.dumps({name: dict.fromkeys(FIGURES, scenes) for name in JUDGED}))

    for seed in (*SEEDS, *MORE):
        put(kept_of(SHIPS, 100, seed), 20.0)
        put(kept_of(WITHOUT, 100, seed), 19.9 if seed in SEEDS else 19.8 + 0.001 * seed)
    for seed in MORE:
        put(mirrored_of(100, seed), 20.3)
    page = written(100)
    assert "| no spectral updates, the first seeds | 3 | -0.10 ± 0.00 * | -0.100 ± 0.000 * |" in page
    assert f"| no spectral updates, new seeds | {len(MORE)} | -0.20 " in page
    assert f"| no spectral updates, all | {len(SEEDS) + len(MORE)} | -0.1" in page
    assert f"| averaged over eight mirror images, the same weights | {len(MORE)} | +0.30 " in page
