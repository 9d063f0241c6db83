"""The lowest versions that pyproject.toml names are ones with which the program works."""

import re
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.recording.file_bytes import HdfBytes
from tests.test_house_rules import TOP


class OldView(bytearray):
    """What h5py before 3.12 hands to a file object: a view that takes no bytes in a slice."""

    def __setitem__(self, place: object, value: object) -> None:
        raise TypeError("an integer is required")


def test_files_are_read_by_every_h5py(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["light"] = np.arange(10)
    held = (tmp_path / "a.h5").read_bytes()
    with (tmp_path / "a.h5").open("rb") as file:
        view = OldView(len(held) + 8)
        HdfBytes(file.fileno(), "a.h5").readinto(view)  # type: ignore[arg-type]
    assert bytes(view) == held + bytes(8)


@pytest.mark.parametrize(
    ("package", "lowest", "for_its"),
    [
        ("typer", (0, 26), "help of arguments, which it lost before"),
        ("pydantic", (2, 10), "get_default(validated_data=...)"),
    ],
)
def test_a_package_is_as_new_as_what_is_used_of_it(package: str, lowest: tuple[int, ...], for_its: str) -> None:
    needed = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    (said,) = (each for each in needed if each.startswith(f"{package}>="))
    assert tuple(map(int, re.findall(r"\d+", said))) >= lowest, for_its
