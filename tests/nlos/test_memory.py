"""What was recorded is not held while a picture is made of it."""

import weakref
from pathlib import Path
from typing import Any

import pytest

from nlos import chain
from nlos.loaded import LoadedScan, load_scan
from nlos.recipe import Recipe
from nlos.results_folder import ResultsFolder
from tests.scan_texts import EIGHT_BY_EIGHT, recorded


class _LetGo(Exception):
    """Where a method would begin."""


def test_a_recording_is_let_go_before_a_method_takes_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[Any] = []

    def load(*args: Any) -> LoadedScan:
        scan = load_scan(*args)
        counts.append(weakref.ref(scan.transient.counts))
        return scan

    def reconstruct(*args: Any) -> None:
        assert [held() for held in counts] == [None]
        raise _LetGo

    monkeypatch.setattr(chain, "load_scan", load)
    monkeypatch.setattr(chain, "reconstruct_transient", reconstruct)
    with pytest.raises(_LetGo):
        chain.reconstruct_file(recorded(tmp_path, EIGHT_BY_EIGHT), Recipe("lct"), ResultsFolder(tmp_path / "seen"))
