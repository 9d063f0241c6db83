"""Networks that learned from clean scans differ from their twins in nothing else, and a queue of them resumes."""

import json
from pathlib import Path

import pytest

from nlos.recon.training.dataset import sample
from nlos.recon.training.train import train
from nlos.recon.training.training_sample import collate
from studies import rows, without_noise
from studies.judged import network_of, scores
from studies.row import Row, rivals
from studies.rows import folder_of, settings_of
from studies.without_noise import CLEAN, SCENES, Trained, figures_of, judge, run, written

UNET = next(row for row in rivals("samples") if row.name == "U-Net")


@pytest.mark.parametrize("row", without_noise.NETWORKS, ids=lambda row: row.name)
def test_only_the_noise_of_what_it_learned_from_is_another(row: Row) -> None:
    noisy, clean = (Trained(row, learned, 2) for learned in ("with noise", "clean"))
    assert noisy.settings(100) == settings_of(row, 100, 2)
    assert noisy.folder(100) == folder_of(row, 100, 2) != clean.folder(100)
    assert noisy.kept(100) != clean.kept(100)
    one, other = (each.settings(100).model_dump() for each in (noisy, clean))
    assert {name for name in one if one[name] != other[name]} <= {"data", "validation", "uniform_noise_most"}
    for scans in ("data", "validation"):  # the best weights on noisy scans would be those that learned least
        assert {name for name in one[scans] if one[scans][name] != other[scans][name]} == {"detector"}


def test_clean_scans_have_no_noise_to_speak_of() -> None:
    made = sample(SCENES.model_copy(update={"scenes": 1}), 0)
    assert (made.exposure > 0).all()
    assert made.counts.max() < 65535  # nothing was cut off
    assert (made.counts.max(axis=0).mean()) == pytest.approx(CLEAN.peak_counts_most, rel=0.05)
    assert made.background == 0


def test_a_queue_of_them_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (rows, without_noise):
        monkeypatch.setattr(module, "FOLDER", tmp_path / "runs")
    monkeypatch.setattr(without_noise, "KEPT", tmp_path / "judged")
    monkeypatch.setattr(without_noise, "NETWORKS", (UNET,))
    few = SCENES.model_copy(update={"scenes": 2})
    judged: list[Path] = []

    def quickly(settings: object, folder: Path, to: Path) -> None:
        judged.append(to)
        judge(settings, folder, to, few)  # type: ignore[arg-type]

    monkeypatch.setattr(without_noise, "judge", quickly)
    run(2, (1,))
    run(2, (1,))
    assert len(judged) == 2
    found = figures_of(UNET, "clean", 2, (1, 2))
    assert found is not None
    assert {amplitude: values.shape for amplitude, values in found.items()} == dict.fromkeys(
        ("0", "3", "5", "10", "30"), (1, 2)
    )
    assert (found["30"] != found["0"]).all()
    page = written(2, (1,))
    assert page.count("| U-Net |") == 3
    assert "| clean less with noise | 1 |" in page
    assert "| clean | 1 |" in page


def test_without_noise_its_figures_are_those_of_the_same_scan(tmp_path: Path) -> None:
    settings = Trained(UNET, "clean", 1).settings(2).model_copy(update={"cache": str(tmp_path / "scenes")})
    train(settings, tmp_path / "run", lambda line: None)
    few = SCENES.model_copy(update={"scenes": 1})
    judge(settings, tmp_path / "run", tmp_path / "figures.json", few)
    network = network_of(settings, few, tmp_path / "run").eval()
    told = scores(network, collate([sample(few, 0)]))["psnr"]
    assert json.loads((tmp_path / "figures.json").read_text())["0"] == [pytest.approx(told, abs=1e-4)]


def test_the_table_says_what_noise_costs_on_average(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(without_noise, "KEPT", tmp_path)
    monkeypatch.setattr(without_noise, "NETWORKS", (UNET,))
    for seed, lost in ((1, 1.0), (2, 3.0)):
        path = Trained(UNET, "clean", seed).kept(2)
        path.parent.mkdir(parents=True, exist_ok=True)
        costs = {f"{a:g}": [20.0 - lost * a, 21.0 - lost * a] for a in without_noise.AMPLITUDES}
        path.write_text(json.dumps({"0": [20.0, 21.0], **costs}))
    cells = [cell.strip() for cell in written(2, (1, 2)).splitlines()[-1].split("|")]
    assert cells[4] == "20.50"
    assert [float(cell.split(" ±")[0]) for cell in cells[5:9]] == [-2 * a for a in without_noise.AMPLITUDES]
