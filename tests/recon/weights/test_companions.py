"""What comes with NANO's weights goes with no others, and no weights name a place on somebody's computer."""

from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import pytest

from nlos.recon.any_noise import any_noise_for
from nlos.recon.film_network import film_network_for
from nlos.recon.intervals import head_for
from nlos.recon.refined import correction_for
from nlos.recon.weights.files import OWN_FOLDER, STUDIES, find_weights, read_weights, save

TIED = (correction_for, any_noise_for, film_network_for, head_for)


@pytest.mark.parametrize("found_for", TIED, ids=lambda each: each.__name__)
def test_it_goes_with_the_weights_that_it_was_fitted_for(
    found_for: Callable[[str | None], object | None], tmp_path: Path
) -> None:
    assert found_for("nano") is not None
    assert found_for("lfe") is None
    assert found_for(None) is None
    shipped = read_weights(find_weights("nano"))
    other = tmp_path / "other.safetensors"
    save(other, {name: x * 1.001 for name, x in shipped.tensors.items()}, shipped.about)
    assert found_for(str(other)) is None


def texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from texts(each)


def kept() -> list[Path]:
    files = [path for folder in (OWN_FOLDER, STUDIES) for path in sorted(folder.iterdir()) if path.is_file()]
    return [path for path in files if path.suffix not in (".md", ".py")]


@pytest.mark.parametrize("path", kept(), ids=lambda path: path.name)
def test_no_weights_say_where_they_were_made(path: Path) -> None:
    told = [
        text
        for text in texts(read_weights(path).about)
        if PurePosixPath(text).is_absolute() or PureWindowsPath(text).is_absolute()
    ]
    assert not told
