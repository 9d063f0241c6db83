"""Every row of the ablation tables can be trained; a queue of them resumes and is shared; errors are honest."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import torch

from nlos.recon.layers.wiener_features import WienerFeatures, counted
from nlos.recon.method import MethodResult
from nlos.recon.methods import find
from nlos.recon.methods.nano import Nano
from nlos.recon.training.dataset import sample
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.network import build
from nlos.recon.training.training_sample import collate
from studies import ablations, rows
from studies.ablations import Claim, run, written
from studies.judged import FIGURES, OverMirrors
from studies.paired import difference
from studies.rivals_given import filled_rates
from studies.row import Row, given
from studies.rows import JUDGED, SEEDS, TABLES, folder_of, in_order, kept_of, settings_of

ROWS = [(title, row) for title, table in TABLES.items() for row in table]


@pytest.mark.parametrize(("title", "row"), ROWS, ids=[f"{title.split()[0]} {row.name}" for title, row in ROWS])
def test_every_row_is_a_valid_training(title: str, row: Row) -> None:
    settings = settings_of(row, 100, 1)
    find(row.method).Settings.model_validate_json(json.dumps(settings.method_settings))
    assert settings.steps == round(100 * row.times) / row.batch


def without(part: str) -> tuple[Nano, Nano]:
    """NANO without it, and as it ships."""
    table = TABLES["NANO as it ships, without one part (this project)"]
    (row,) = (row for row in table if row.switches.get("without") == part)
    made = []
    for each in (row, table[-1]):
        settings = settings_of(each, 1, 1)
        network = build(settings, settings.data.wall, settings.data.time)
        assert isinstance(network, Nano)
        made.append(network)
    return made[0], made[1]


def test_without_empty_gaps_the_filled_volume_comes_twice() -> None:
    data = settings_of(ROWS[0][1], 1, 1).data
    batch = collate([sample(data.model_copy(update={"detector": DetectorSettings(sparse=1.0)}), 0)])
    network, whole = without("empty gaps")
    with torch.inference_mode():
        filled, volumes = (each.prepared(batch["counts"], batch["exposure"]).volumes for each in (network, whole))
    assert torch.equal(filled[:, -1], filled[:, -2])
    assert torch.equal(filled[:, :-1], volumes[:, :-1])
    assert not torch.equal(volumes[:, -1], volumes[:, -2])


def test_without_the_2d_network_nothing_of_it_is_trained() -> None:
    network, whole = without("2D network")
    ours, theirs = ({name for name, _ in each.named_parameters()} for each in (network, whole))
    assert ours < theirs
    assert all(name.startswith("projection.finish.") for name in theirs - ours)


def test_rows_that_differ_have_folders_of_their_own_and_equal_ones_share() -> None:
    folders = {folder_of(row, 100, 1): settings_of(row, 100, 1) for _, row in ROWS}
    for _, row in ROWS:
        assert folders[folder_of(row, 100, 1)] == settings_of(row, 100, 1)
    judged = {(folder_of(row, 100, 1), row.mirrored) for _, row in ROWS}
    assert len(in_order(100)) == len(judged) * len(SEEDS)
    assert len({kept_of(row, 100, 1) for _, row in ROWS}) == len(judged)


SPARSE = DetectorSettings(sparse=1.0, uneven_dwell=1.0)


def test_rivals_are_shown_gaps_filled_and_empty() -> None:
    data = settings_of(ROWS[0][1], 1, 1).data.model_copy(update={"detector": SPARSE})
    batch = collate([sample(data, 0)])
    exposure = batch["exposure"]
    gaps = exposure == 0
    assert gaps.any()
    seen = counted(batch["counts"], exposure)
    filled = filled_rates(seen, batch["counts"], exposure)
    assert (seen.rate.sum(dim=(1, 2))[gaps] == 0).all()
    assert (filled.sum(dim=(1, 2))[gaps] > 0).float().mean() > 0.9
    for kind in ("lfe", "nlost"):
        network = given_network(kind)
        shown = network.shown(seen, batch["counts"], exposure)
        assert torch.equal(shown, torch.cat((filled, seen.rate), dim=1))
        channels = network.encoder(shown)
        assert torch.equal(channels[:, :1], network.encoder.average(filled))
        assert torch.equal(channels[:, 1:2], network.encoder.average(seen.rate))
    with torch.inference_mode():
        volumes = given_network("unet").physics(batch["counts"], exposure).volumes
        once = WienerFeatures(data.wall, data.time, farthest=0.9)(batch["counts"], exposure).volumes
    assert volumes.shape[1] == once.shape[1] + 1
    assert not torch.allclose(volumes[:, 0], once[:, 0])  # of filled rates


def test_of_a_whole_scan_filled_and_empty_are_the_same() -> None:
    data = settings_of(ROWS[0][1], 1, 1).data
    batch = collate([sample(data.model_copy(update={"detector": DetectorSettings(sparse=0.0)}), 0)])
    with torch.inference_mode():
        seen = counted(batch["counts"], batch["exposure"])
        assert torch.allclose(filled_rates(seen, batch["counts"], batch["exposure"]), seen.rate, atol=1e-6)
        volumes = given_network("unet").physics(batch["counts"], batch["exposure"]).volumes
        once = WienerFeatures(data.wall, data.time, farthest=0.9)(batch["counts"], batch["exposure"]).volumes
    assert torch.allclose(volumes[:, :2], once, atol=1e-4)
    assert torch.allclose(volumes[:, 2], once[:, 1], atol=1e-4)


def given_network(rival: str) -> Any:
    settings = settings_of(given(rival, False), 1, 1)
    return build(settings, settings.data.wall, settings.data.time)


class Corner(torch.nn.Module):
    """Brightness is that of the photons, depth is said in one corner alone."""

    def forward(self, counts: torch.Tensor, exposure: torch.Tensor) -> MethodResult[torch.Tensor]:
        depth_m = torch.full_like(exposure, torch.nan)
        depth_m[:, 0, 0] = 0.5
        depth_m[:, :, 1] = 2.0
        depth_m[:, 1, :] = 1.0
        return MethodResult(counts.sum(dim=(1, 2)) + torch.arange(exposure.shape[-1]), depth_m)


def test_the_mean_over_mirrors_turns_with_the_wall_and_says_depths_that_half_say() -> None:
    counts, exposure = torch.rand(1, 1, 4, 3, 3), torch.ones(1, 3, 3)
    made = OverMirrors(Corner())(counts, exposure)
    assert torch.allclose(made.albedo, counts.sum(dim=(1, 2)) + 1)  # the ramp of 0, 1, 2 is even over all mirrors
    assert made.depth_m[0, 1, 1] == 1.0
    assert made.depth_m[0, 0, 0].isnan()  # two of eight say one
    assert made.depth_m[0, 0, 1] == pytest.approx(1.5)  # four say 2 m and four say 1


def test_all_rows_of_a_seed_come_before_the_next_seed_and_the_dearest_last() -> None:
    order = in_order(100)
    assert [seed for _, seed in order] == sorted(seed for _, seed in order)
    first = [row.switches.get("outer_iterations", 1) for row, seed in order if seed == 1]
    assert first == sorted(first)


def test_a_difference_is_paired_and_its_error_is_that_of_seeds_and_scenes() -> None:
    rng = np.random.default_rng(1)
    scenes, seeds = rng.normal(0, 5, (1, 400)), rng.normal(0, 0.3, (3, 1))
    other = 20 + scenes + rng.normal(0, 0.1, (3, 400))
    row = other + 1 + seeds + rng.normal(0, 0.5, (3, 400))
    found = difference(row, other)
    assert found.mean == pytest.approx(1 + seeds.mean(), abs=0.1)
    assert found.error == pytest.approx(seeds.std(ddof=1) / 3**0.5, rel=0.3)
    assert found.freedom == pytest.approx(2, rel=0.2)  # of the seeds, which differ more than scenes do
    assert found.told == (abs(found.mean) > scipy.stats.t.ppf(0.975, found.freedom) * found.error)
    assert not difference(row[:1], other[:1]).told


@pytest.mark.parametrize("seeds", [2, 3, 5])
@pytest.mark.parametrize("apart", [0.02, 0.2])
def test_errors_hold_what_they_promise(seeds: int, apart: float) -> None:
    """Of differences that are nothing, about one in twenty is told from it, of two seeds that differ much one in nine;
    at two errors it would be one in five."""
    rng = np.random.default_rng(2)
    told = 0
    for _ in range(600):
        scenes = rng.normal(0, 1, (1, 30))
        a, b = (scenes + rng.normal(0, apart, (seeds, 1)) + rng.normal(0, 0.3, (seeds, 30)) for _ in range(2))
        told += difference(a, b).told
    assert told / 600 < (0.14 if seeds == 2 else 0.09)


def test_a_scene_without_a_depth_is_left_to_the_others() -> None:
    row = np.array([[1.0, np.nan, 3.0], [1.2, np.nan, 3.1]])
    assert difference(row, row - 0.5).mean == pytest.approx(0.5)


def judged_as(kept: Path, value: float) -> None:
    kept.parent.mkdir(parents=True, exist_ok=True)
    figures = {name: {figure: [value, value + 1] for figure in FIGURES} for name in JUDGED}
    kept.write_text(json.dumps(figures))


def test_the_page_gives_differences_to_the_last_row_with_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows, "KEPT", tmp_path)
    parts = next(iter(TABLES.values()))
    for k, row in enumerate(parts):
        for seed in (1, 2):
            judged_as(kept_of(row, 100, seed), 20.0 + k + 0.001 * seed)
    text = written(ablations.known(100, (1, 2)), 100, (1, 2))
    assert "| IV: no SFE | 2 | 23.50 | -1.00 ± 0.00 * |" in text
    assert "| I: global alone | 0 |" in text
    assert "\n10 of" in text


def test_a_row_that_another_process_works_on_is_passed_over_until_that_is_gone(tmp_path: Path) -> None:
    (tmp_path / ablations.CLAIM).write_text("1")  # a process that lives as long as the machine
    with Claim(tmp_path) as mine:
        assert not mine
    (tmp_path / ablations.CLAIM).write_text("999999999")
    with Claim(tmp_path) as mine:
        assert mine
    assert not (tmp_path / ablations.CLAIM).exists()


def test_the_queue_trains_judges_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = {"rows": 8, "cols": 8, "bins": 32, "bin_width_ps": 512.0}
    monkeypatch.setattr(rows, "FOLDER", tmp_path)
    monkeypatch.setattr(rows, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(rows, "SMALL", tiny)
    monkeypatch.setattr(rows, "WATCHED", rows.WATCHED.model_copy(update=tiny | {"scenes": 1}))
    small = {name: data.model_copy(update=tiny | {"scenes": 2}) for name, data in JUDGED.items()}
    monkeypatch.setattr(ablations, "JUDGED", small)
    table = {
        "t": (
            Row("none", switches={"lifting": "none", "channels": [4, 4]}),
            Row("light-cone transform", "lct"),
            Row("whole, mirrored", switches={"channels": [4, 4]}, mirrored=True),
            Row("whole", switches={"channels": [4, 4]}),
        )
    }
    monkeypatch.setattr(rows, "TABLES", table)
    monkeypatch.setattr(ablations, "TABLES", table)
    run(2, (1,), tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert "2 of 2 trainings are done: 2 rows with 1 seeds" in page  # the light-cone transform is judged, not trained
    times = [path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.json")]
    assert len(times) == 4
    assert len(list((tmp_path / "kept" / "mirrored").rglob("*.json"))) == 1
    run(2, (1,), tmp_path / "page.md")
    assert [path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.json")] == times


def test_a_row_that_was_told_to_end_is_not_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "FOLDER", tmp_path)
    monkeypatch.setattr(rows, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(ablations, "train", lambda *_: {"finished": False, "signal": 2})
    run(2, (1,), tmp_path / "page.md")
    assert not (tmp_path / "kept").exists()
    assert not (tmp_path / "page.md").exists()
