"""A file that a command writes appears whole or not at all, in the place of an older one."""

from pathlib import Path

import pytest

from nlos.whole_file import whole_file


def test_what_was_written_is_in_the_place_of_the_older_file_and_nothing_beside_it(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("old")
    with whole_file(tmp_path / "page.html") as partial:
        partial.write_text("new")
        assert (tmp_path / "page.html").read_text() == "old"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"page.html": "new"}


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_what_was_cut_short_leaves_the_older_file_and_nothing_beside_it(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "page.html").write_text("old")

    def write() -> None:
        with whole_file(tmp_path / "page.html") as partial:
            partial.write_text("half of the ne")
            raise error

    with pytest.raises(type(error)):
        write()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"page.html": "old"}


def test_two_who_write_one_file_at_once_both_write_it_whole(tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    with whole_file(target) as first:
        first.write_text("first")
        with whole_file(target) as second:
            second.write_text("second")
        assert target.read_text() == "second"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"page.html": "first"}
