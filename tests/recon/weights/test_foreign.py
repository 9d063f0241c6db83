"""Weights from outside become plain tensors in a child process, or an error; nothing in them runs."""

import os
from pathlib import Path

import pytest
import torch

from nlos.recon.weights.files import WeightsError, load_weights
from nlos.recon.weights.foreign import ForeignWeightsError, read_foreign


class Forged:
    """What a forged pickle does when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.path),)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("nested", [False, True])
def test_a_state_dict_is_read_and_its_shapes_are_checked(tmp_path: Path, nested: bool) -> None:
    layer = torch.nn.Linear(2, 3)
    state = layer.state_dict()
    torch.save({"state_dict": state} if nested else state, tmp_path / "w.pt")
    fresh = torch.nn.Linear(2, 3)
    load_weights(fresh, str(tmp_path / "w.pt"))
    assert torch.equal(fresh.weight, layer.weight)
    with pytest.raises(WeightsError, match=r"weight is \(3, 2\), not \(4, 2\)"):
        load_weights(torch.nn.Linear(2, 4), str(tmp_path / "w.pt"))


def test_a_forged_file_runs_nothing(tmp_path: Path) -> None:
    torch.save({"weight": Forged(tmp_path / "ran")}, tmp_path / "w.pt")
    with pytest.raises(ForeignWeightsError, match="UnpicklingError"):
        read_foreign(tmp_path / "w.pt")
    assert not (tmp_path / "ran").exists()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("held", "why"),
    [([1, 2], "list"), ({"a": 1}, "int"), ({"a": torch.tensor([float("nan")])}, "finite"), (b"noise", "w.pt")],
)
def test_anything_else_is_refused_with_the_reason(tmp_path: Path, held: object, why: str) -> None:
    if isinstance(held, bytes):
        (tmp_path / "w.pt").write_bytes(held)
    else:
        torch.save(held, tmp_path / "w.pt")
    with pytest.raises(ForeignWeightsError, match=why):
        read_foreign(tmp_path / "w.pt")
