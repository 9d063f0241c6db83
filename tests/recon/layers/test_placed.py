"""A network is moved once, and found where it is afterwards."""

import pytest
import torch
from torch import nn

from nlos.recon.layers.placed import placed


def test_a_network_is_moved_to_another_device_and_left_alone_there(monkeypatch: pytest.MonkeyPatch) -> None:
    network = nn.Sequential(nn.Linear(2, 2), nn.BatchNorm1d(2))
    moved = placed(network, "meta")
    assert {tensor.device.type for tensor in (*moved.parameters(), *moved.buffers())} == {"meta"}
    monkeypatch.setattr(nn.Module, "to", lambda *given: pytest.fail("looked through again"))
    assert placed(moved, torch.device("meta")) is moved


def test_of_a_network_without_tensors_torch_decides() -> None:
    network = nn.ReLU()
    assert placed(network, "cpu") is network
