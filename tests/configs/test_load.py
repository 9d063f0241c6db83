"""A YAML file becomes settings, or a message that begins with file, line and column."""

from pathlib import Path
from typing import Annotated, Literal

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from nlos.cli.exit_codes import ExitCode, exit_code
from nlos.configs.kinds import Kind
from nlos.configs.load import ConfigError, find, load, parse
from nlos.configs.read_whole import ConfigNotRead
from nlos.configs.settings import Settings


class Circle(Settings):
    kind: Literal["circle"]
    radius_m: float = Field(gt=0)


class Grid(Settings):
    kind: Literal["grid"]
    rows: int = Field(gt=0)


class Demo(Settings):
    name: str = "demo"
    dwell_ms: float = Field(gt=0)
    limits: tuple[float, float] = (0.0, 1.0)
    shape: Annotated[Circle | Grid, Field(discriminator="kind")] = Circle(kind="circle", radius_m=1.0)


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse(text, "demo.yaml", Demo)
    return str(caught.value)


def test_lists_become_tuples_and_whole_numbers_floats() -> None:
    settings = parse("dwell_ms: 8\nlimits: [1, 2.5]\nshape: {kind: grid, rows: 3}\n", "demo.yaml", Demo)
    assert settings.limits == (1.0, 2.5)
    assert settings.shape == Grid(kind="grid", rows=3)


def test_an_unknown_key_is_refused_where_it_stands_with_the_nearest_known_one() -> None:
    assert refusal("dwell_ms: 1.0\ndwel: 2\n").startswith("demo.yaml:2:1: dwel: no such key. Did you mean 'dwell_ms'?")
    message = refusal("dwell_ms: 1.0\nshape:\n  kind: circle\n  radius: 2.0\n")
    assert message.startswith("demo.yaml:4:3: shape.radius: no such key. Did you mean 'radius_m'?") or (
        "demo.yaml:4:3: shape.radius: no such key. Did you mean 'radius_m'?" in message
    )


def test_what_is_wrong_within_a_list_does_not_leave_too_few() -> None:
    class Several(Settings):
        shapes: tuple[Circle, ...] = Field(min_length=1)

    with pytest.raises(ConfigError) as caught:
        parse("shapes:\n  - {kind: circle, radius_m: 1.0, width: 3}\n", "demo.yaml", Several)
    assert str(caught.value) == "demo.yaml:2:35: shapes[0].width: no such key."
    with pytest.raises(ConfigError, match="shapes: Tuple should have at least 1 item"):
        parse("shapes: []\n", "demo.yaml", Several)


def test_a_key_of_another_branch_is_not_suggested_where_it_is_refused() -> None:
    """Here `rows` is a grid's; nobody is asked whether the very word was meant."""
    message = refusal("dwell_ms: 1.0\nshape: {kind: circle, radius_m: 1.0, rows: 3}\n")
    assert message == "demo.yaml:2:38: shape.rows: no such key."


def test_a_number_that_yaml_reads_as_text_is_explained() -> None:
    message = refusal("dwell_ms: 1e-3\n")
    assert message.startswith("demo.yaml:1:1: dwell_ms: ")
    assert "1.0e-3" in message
    assert "'1e-3'" in message


@pytest.mark.parametrize(
    ("text", "start", "part"),
    [
        ("dwell_ms: 1.0\ndwell_ms: 2.0\n", "demo.yaml:2:1: dwell_ms", "given twice"),
        ("dwell_ms: -1\n", "demo.yaml:1:1: dwell_ms", "greater than 0"),
        ("dwell_ms: .nan\n", "demo.yaml:1:1: dwell_ms", "finite"),
        ("name: x\n", "demo.yaml:1:1: dwell_ms", "missing"),
        ("dwell_ms: 1.0\nname: !!python/name:os.system x\n", "demo.yaml:2:7: name", "tags"),
        ("dwell_ms: 1.0\nname: 2026-01-01x\n  bad: [\n", "demo.yaml:3:", "not valid YAML"),
        ("shape:\n\tkind: circle\n", "demo.yaml:2:1", "Lines are indented by spaces"),
        ("dwell_ms: '1'\n", "demo.yaml:1:1: dwell_ms", "(given '1'). It is in quotes; leave them out."),
        ("dwell_ms: 1,5\n", "demo.yaml:1:1: dwell_ms", "Decimals follow a dot: 1.5."),
        ("shape: {radius_m: 1,0, kind: circle}\n", "demo.yaml:1:21", "decimals follow a dot"),
        ("dwell_ms: 4 ms\n", "demo.yaml:1:1: dwell_ms", "Write the number alone"),
        ("dwell_ms: 1.0\nname: no\n", "demo.yaml:2:1: name", "YAML takes no, off and false for False; a word"),
        ("- 1\n", "demo.yaml:1:1", "key: value"),
        ("", "demo.yaml:1:1", "empty"),
        ("dwell_ms: 1.0\nshape: {kind: circel, radius_m: 1.0}\n", "demo.yaml:2:", "Did you mean 'circle'"),
        ("dwell_ms: 1.0\n? [a]\n: 2\n", "demo.yaml:2:3", "keys must be plain words"),
        ("dwell_ms: " + "9" * 400 + "\n", "demo.yaml:1:11: dwell_ms", "too large"),
        ("[" * 5000, "demo.yaml:1:", "nested too deep"),
        ("a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
            f"{c}: &{c} [{', '.join(['*' + p] * 9)}]\n" for p, c in zip("abcdefgh", "bcdefghi", strict=True)
        ), "demo.yaml:", "too many"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(text: str, start: str, part: str) -> None:
    message = refusal(text)
    assert message.startswith(start), message
    assert part in message


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        parse(text, "demo.yaml", Demo)
    except ConfigError as error:
        message = str(error)
    else:
        return
    assert message.startswith("demo.yaml:")


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no file whose first byte is an error of the disk's")
def test_a_disk_that_fails_says_nothing_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(
        ConfigNotRead, match=r"bench\.yaml: cannot be read \(Input/output error\).*sound disk"
    ) as raised:
        load("bench", str(path), Demo)
    assert exit_code(raised.value) is ExitCode.STORAGE


def test_a_path_wins_over_a_name_and_an_unknown_name_lists_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("dwell_ms: 2.0\n")
    loaded = load("scan", str(path), Demo)
    assert (loaded.settings.dwell_ms, loaded.text) == (2.0, "dwell_ms: 2.0\n")
    with pytest.raises(ConfigError, match="no such file, and no scan of that name"):
        find("scan", "no-such-scan")


def test_bytes_that_are_not_text_are_refused_by_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "bytes.yaml"
    path.write_bytes(b"dwell_ms: 1.0\nname: \xff\n")
    with pytest.raises(ConfigError, match=r"bytes\.yaml:2:7: byte 0xff is not UTF-8 text\. Save the file as UTF-8"):
        load("scan", str(path), Demo)


@pytest.mark.parametrize(
    ("kind", "text", "says"),
    [
        ("scan", "bench/simulated", "is a bench file (mirror, counter, shutter, geometry), and a scan file is wanted"),
        (
            "bench",
            "scan/demo",
            "is a scan file (wall, pattern, histogram), and a bench file is wanted here. `nlos scan",
        ),
        ("train", "scan/demo", "is a scan file (wall, pattern, histogram), and a training file is wanted here."),
        (
            "scan",
            "train/lfe",
            "is a training file (method, learning_rate), and a scan file is wanted here. `nlos train FILE`",
        ),
    ],
)
def test_a_file_of_another_kind_is_told_as_such_in_one_line(kind: Kind, text: str, says: str, tmp_path: Path) -> None:
    """As who mixes up the two files of `nlos scan SCAN --bench BENCH` meets it: not once for every key."""
    own, name = text.split("/")
    taken = tmp_path / "mixed-up.yaml"
    taken.write_bytes(find(own, name).read_bytes())  # type: ignore[arg-type]
    with pytest.raises(ConfigError) as caught:
        load(kind, str(taken), Demo)
    assert str(caught.value).startswith(f"{taken}:1:1: {says}")
    assert "\n" not in str(caught.value)


def test_a_recording_in_place_of_a_scan_file_is_told_as_such_however_long_it_is(tmp_path: Path) -> None:

    for name, size in (("short.h5", 1), ("long.h5", 2 << 20)):
        with h5py.File(tmp_path / name, "w") as file:
            file["histograms"] = np.zeros(size, dtype=np.uint8)
        with pytest.raises(ConfigError, match=r"is HDF5, as recordings and results are; .*-o names the recording"):
            load("scan", str(tmp_path / name), Demo)


def test_a_key_that_is_wrong_in_a_file_of_the_right_kind_is_still_named(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("wall: 1\ndwell: 2\nruns: []\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml:2:1: dwell: no such key"):
        load("scan", str(tmp_path / "mine.yaml"), Demo)
