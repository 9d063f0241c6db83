"""Every row of the ablation tables is a network that can be built, and the page says what was found."""

import json
from pathlib import Path

import pytest

from nlos.recon.methods.nano import Settings
from studies.ablations import LOG, TABLES, WHOLE, Row, finished, folder_of, in_order, page, settings_of

ROWS = [row for rows in TABLES.values() for row in rows]


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_every_row_is_a_valid_training_of_nano(row: Row) -> None:
    settings = settings_of(row, 100)
    Settings.model_validate_json(json.dumps(settings.method_settings))
    assert settings.steps == 50


def test_rows_that_differ_have_folders_of_their_own_and_equal_ones_share() -> None:
    folders = {folder_of(row, 100): (row.switches, row.loss) for row in ROWS}
    for row in ROWS:
        assert folders[folder_of(row, 100)] == (row.switches, row.loss)


def test_the_page_gives_differences_to_the_last_row() -> None:
    parts = next(iter(TABLES.values()))
    known = {folder_of(row, 100): {"psnr": 20.0 + k, "depth_mad_m": 0.02} for k, row in enumerate(parts)}
    text = page(known, 100)
    assert "| IV: no SFE | 23.00 | -1.00 | -1.61 | 20.0 | 25 |" in text
    assert "| I: global alone | not trained yet | | -2.43 | | 28 |" in text


def test_the_row_that_all_are_compared_with_is_trained_first() -> None:
    assert in_order()[0].switches == WHOLE


def test_a_row_is_finished_when_its_log_says_so(tmp_path: Path) -> None:
    assert finished(tmp_path) is None
    (tmp_path / LOG).write_text('{"step": 1}\n')
    assert finished(tmp_path) is None
    (tmp_path / LOG).write_text('{"step": 2, "minutes": 1.5, "validation": {"psnr": 20.0}, "finished": true}\n')
    assert finished(tmp_path) == {"psnr": 20.0}
