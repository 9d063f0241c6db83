"""Every row of the ablation tables is a network that can be built, and the page says what was found."""

import json

import pytest

from recon.methods.nano import Settings
from recon.training.ablations import TABLES, Row, folder_of, page, settings_of

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
    results = {
        title: [{"psnr": 20.0 + k, "depth_mad_m": 0.02} for k in range(len(rows))] for title, rows in TABLES.items()
    }
    text = page(results, 100)
    assert "| IV: no SFE | 23.00 | -1.00 | -1.61 | 0.0200 | 0.025 |" in text
