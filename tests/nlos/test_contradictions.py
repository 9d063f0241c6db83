"""Options that exclude one another are refused by name, before anything is read, written, moved or lit."""

from pathlib import Path

import pytest

from nlos.cli.app import load_verb
from nlos.cli.exit_codes import ExitCode, exit_code
from nlos.configs.load import ConfigError

NOBODY = "nobody.h5"
FILM, FOLLOW = ("--film", NOBODY), ("--follow", NOBODY)
OF_FILES = (
    ("--wall-size-m", "2"), ("--bin-width-ps", "32"), ("--axes", "TYX"), ("--raw",), ("--depth-m", "0.5:2"),
    ("--frame", "1"), ("--scheduler", "local"), ("--set", "offsets=file"),
)  # fmt: skip
PAIRS = [
    *(("reconstruct", FOLLOW, each) for each in (*OF_FILES, ("--film",), ("--skip-existing",))),
    *(("reconstruct", FILM, each) for each in (*OF_FILES, ("--html",), ("--no-volume",))),
    ("reconstruct", FILM, ("other.h5",)),
    ("reconstruct", FOLLOW, ("other.h5",)),
    ("reconstruct", (NOBODY,), ("--window", "2")),
    ("reconstruct", (NOBODY,), ("--memory",)),
    ("reconstruct", (NOBODY, "--overwrite"), ("--skip-existing",)),
    ("reconstruct", (NOBODY, "--set", "offsets=file"), ("--rectified",)),
    ("reconstruct", (NOBODY, "--weights", "nano.safetensors"), ("--set", "weights=mine.safetensors")),
    *(("scan", ("demo", "--sweep", "dwell_ms=1,2"), each) for each in (
        ("--resume",), ("--live",), ("--until", "stable"), ("--scene", NOBODY), ("--overwrite",),
        ("--weights", "nano.safetensors"), ("--response", "300"),
    )),
    ("scan", ("demo", "--resume"), ("--overwrite",)),
    ("scan", ("demo",), ("--response", "300")),
    ("scan", ("demo", "--bench", "lab"), ("--scene", NOBODY)),
    ("replay", (NOBODY,), ("--response", "300")),
    ("export", (NOBODY, "--to", "npz"), ("--method", "fk")),
    *(("calibrate", ("--first-light",), each) for each in (
        (NOBODY,), ("--dead-time-ns", "40"), ("--response", NOBODY), ("--wall-size-m", "2"), ("--dark",),
        ("--spots", "spots.csv"),
    )),
    *(("calibrate", ("--spots", "spots.csv"), each) for each in (
        ("--dead-time-ns", "40"), ("--response", NOBODY), ("--wall-size-m", "2"), ("--dark",), ("--light",),
    )),
    *(("calibrate", (NOBODY,), each) for each in (("--bench", "simulated"), ("--light",))),
    ("train", ("nano", "--check"), ("--max-minutes", "3")),
    ("point", ("0", "0", "--hold", "1"), ("--light", "2")),
    ("doctor", ("--bench", "simulated"), ("-o", "page.html")),
]  # fmt: skip


@pytest.mark.parametrize(
    ("verb", "first", "second"), PAIRS, ids=lambda said: said if isinstance(said, str) else " ".join(said)
)
def test_a_pair_of_options_is_refused_by_name(
    verb: str, first: tuple[str, ...], second: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What, why, and what to do instead: no option wins silently over another. Nothing is left in the folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Exception, match=r"\w") as refused:
        load_verb(verb).main([*first, *second], standalone_mode=False)
    assert exit_code(refused.value) is ExitCode.USAGE
    said, option = str(refused.value), second[0]
    name = {NOBODY: "RUN", "other.h5": "one"}.get(option, option)
    assert (f"{option} {second[1]}" if option == "--set" else name).partition("=")[0] in said
    assert len(said.rstrip(".").split(". ")) >= 2, said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        *(("reconstruct", (NOBODY, *each)) for each in OF_FILES if each[0] != "--scheduler"),
        *(("reconstruct", (NOBODY, each)) for each in ("--overwrite", "--skip-existing", "--html", "--no-volume")),
        *(("reconstruct", (*FILM, *each)) for each in (("--window", "2"), ("--response", "300"), ("--skip-existing",))),
        *(
            ("reconstruct", ("--follow", "nobody.ticket", *each))
            for each in (("--html",), ("--no-volume",), ("--response", "300"))
        ),
        *(("scan", ("nobody.yaml", each)) for each in ("--resume", "--overwrite")),
        ("train", ("nobody.yaml", "--max-minutes", "1")),
    ],
    ids=str,
)  # fmt: skip
def test_what_goes_together_is_not_refused(
    verb: str, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each gets as far as the file that is not there."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises((FileNotFoundError, ConfigError), match="nobody"):
        load_verb(verb).main([*words], standalone_mode=False)
