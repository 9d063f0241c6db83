"""A file that a command writes appears whole or not at all, in the place of an older one."""

import os
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.new_name import put_new
from nlos.whole_file import whole_file
from tests.command import nlos


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


@pytest.mark.parametrize("links", [True, False])
def test_a_new_file_takes_no_place_that_was_taken_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    def write(name: str, other: str | None = None) -> None:
        with whole_file(tmp_path / name, new=True) as partial:
            partial.write_text("new")
            if other:
                (tmp_path / name).write_text(other)

    if not links:  # memory sticks
        monkeypatch.setattr(os, "link", raising(PermissionError(1, "Operation not permitted")))
    write("alone.html")
    with pytest.raises(FileExistsError, match=r"page\.html: exists by now: another program has made it"):
        write("page.html", "another's")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "alone.html": "new", "page.html": "another's"
    }  # fmt: skip


@pytest.mark.parametrize("links", [True, False])
def test_of_programs_that_give_one_name_at_the_same_time_one_gets_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    if not links:
        monkeypatch.setattr(os, "link", raising(PermissionError(1, "Operation not permitted")))
    ready = threading.Barrier(4)

    def gives(number: int, target: Path) -> bool:
        own = tmp_path / f"{target.name}.{number}"
        own.write_text(str(number))
        ready.wait(60)
        try:
            put_new(own, target)
        except FileExistsError:
            return False
        return True

    with ThreadPoolExecutor(4) as pool:
        for tried in range(200):
            target = tmp_path / f"page-{tried}.html"
            got = list(pool.map(gives, range(4), [target] * 4))
            assert got.count(True) == 1
            assert target.read_text() == str(got.index(True))


def test_a_name_whose_taking_the_share_was_asked_twice_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network share whose first answer was lost says at the second time that the name is there."""
    real = os.link

    def asked_twice(path: Path, target: Path) -> None:
        real(path, target)
        real(path, target)

    monkeypatch.setattr(os, "link", asked_twice)
    with whole_file(tmp_path / "page.html", new=True) as partial:
        partial.write_text("new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"page.html": "new"}


def test_no_name_is_taken_for_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        put_new(tmp_path / "gone.part", tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_a_name_that_could_not_be_given_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", raising(PermissionError(1, "Operation not permitted")))
    monkeypatch.setattr(Path, "replace", raising(OSError(5, "Input/output error", str(tmp_path / "page.html"))))
    with pytest.raises(StorageError, match="Input/output error"), whole_file(tmp_path / "page.html", new=True) as made:
        made.write_text("new")
    assert not list(tmp_path.iterdir())


def raising(error: OSError) -> Callable[..., None]:
    def fails(*words: object, **more: object) -> None:
        raise error

    return fails


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    nlos(folder, "scan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5", check=True)
    nlos(folder, "reconstruct", "run.h5", "-o", "picture", check=True)
    return folder


VERBS = [
    "export run.h5 --to npz -o it.npz", "export picture/reconstruction.h5 --to ply -o it.ply",
    "figure picture -o it.pdf",
    "report run.h5 --methods lct -o it.html", "plan five_by_five --bench zero_latency --picture it.png",
    "runs --page it.html", "new bench --simulated --no-check -o it.yaml",
]  # fmt: skip


@pytest.mark.parametrize("words", VERBS)
def test_no_verb_replaces_a_file_that_came_while_it_computed(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    target = tmp_path / words.split()[-1]
    monkeypatch.setattr("nlos.whole_file.check_writable", lambda folder: target.write_text("another's"))
    done = nlos(tmp_path, *words.split())
    assert done.returncode == 6, done.stderr
    assert f"{target.name}: exists by now" in done.stderr
    assert target.read_text() == "another's"
    assert not list(tmp_path.glob(".*.part"))
    assert nlos(tmp_path, *words.split(), "--overwrite").returncode == 0
    assert target.read_bytes() != b"another's"


def test_a_bench_file_that_the_disk_does_not_take_leaves_the_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["new", "bench", "--simulated", "--no-check", "-o", "lab.yaml", "--overwrite"]
    (tmp_path / "lab.yaml").write_text("name: older")

    def half(path: Path, *words: object, **more: object) -> None:
        path.write_bytes(b"name: l")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_text", half)
    assert nlos(tmp_path, *words).returncode == 6
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]
    assert (tmp_path / "lab.yaml").read_text() == "name: older"
