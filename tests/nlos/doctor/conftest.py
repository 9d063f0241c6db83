"""What the doctor says of a bench here does not depend on what is installed beside it."""

import pytest

from nlos.doctor import surroundings


@pytest.fixture(autouse=True)
def libusb_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is missing, a line about software would stand before what these tests look for."""
    monkeypatch.setattr(surroundings, "available_instruments", list)
