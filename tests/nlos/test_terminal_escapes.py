"""Nothing in a file, or in a file's name, commands the terminal of whoever looks at it: over all verbs."""

import io
import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.to_recording import write_recording
from nlos.cli.app import VERBS
from nlos.cli.escaped import EscapedStream, escaped

EVIL = "\x1b]0;owned\x07\x1b[31m\x9b2J\u202e"
NAME = "a\x1b[31m\x07\u202eb"
COMMANDING = {chr(code) for code in (*range(32), 127, *range(128, 160), 0x202E)} - {"\n", "\t"}

RUNS_ALL = """
import contextlib, io, json, sys
from nlos.__main__ import run
from nlos.cli.escaped import escape_what_is_printed
from nlos.cli.terminal import terminal
outputs = []
for words in json.loads(sys.stdin.read()):
    raw = io.StringIO()
    sys.stdout = sys.stderr = raw
    escape_what_is_printed()
    terminal.verbosity = 1
    code = run(words)
    outputs.append((code, raw.getvalue()))
print(json.dumps(outputs), file=sys.__stdout__)
"""


@pytest.fixture
def evil(tmp_path: Path, plain: Path) -> Path:
    """A folder of files whose names and contents command the terminal."""
    write_recording(read_any(plain), plain, tmp_path / f"{NAME}.h5")
    with h5py.File(tmp_path / f"{NAME}.h5", "r+") as file:
        file["events"][0] = (0.0, 0.0, EVIL.encode()[:24], EVIL.encode())
        del file["header/warnings"], file["header/scan_text"], file["header/devices"], file["header/software"]
        device = dict.fromkeys(("product", "serial", "model", "firmware"), EVIL)
        texts = {"warnings": json.dumps([EVIL]), "scan_text": EVIL, "software": json.dumps({EVIL: EVIL}),
                 "devices": json.dumps({EVIL: device})}  # fmt: skip
        for name, text in texts.items():
            raw = text.encode()
            file.create_dataset(f"header/{name}", data=np.array(raw, dtype=h5py.string_dtype("utf-8", len(raw))))
    with h5py.File(tmp_path / "names.h5", "w") as file:
        file[EVIL] = np.ones(3)
    np.savez(tmp_path / "names.npz", **{EVIL: np.ones(3)})
    (tmp_path / "keys.yaml").write_text('"\\e]0;owned\\a\\e[31m": 1\nwall: {"\\x9b2J": 2}\n', encoding="utf-8")
    (tmp_path / f"{NAME}.yaml").write_text("wall: 1\n")
    (tmp_path / f"{NAME}.txt").write_text("neither\n")
    (tmp_path / "spots.csv").write_text(f"x_deg,{EVIL}\n1,2\n", encoding="utf-8")
    return tmp_path


def commands() -> list[list[str]]:
    """Every verb with every hostile file that it could be given, none of which opens a port or waits."""
    data = [f"{NAME}.h5", "names.h5", "names.npz", f"{NAME}.txt", f"missing{NAME}.h5"]
    scans = ["keys.yaml", f"{NAME}.yaml", f"missing{NAME}"]
    found = [[verb, file] for verb in ("info", "verify", "report", "reconstruct", "calibrate") for file in data]
    found += [["export", file, "--to", word] for file in data for word in ("npz", "ply", EVIL)]
    found += [["recover", file, "-o", f"out{NAME}.h5"] for file in data]
    found += [["import", file, "-o", f"in{NAME}.h5"] for file in data]
    found += [["replay", file, "--speed", "max"] for file in data]
    found += [["live", data[3]], ["live", data[1]], ["serve", data[1]], ["serve", data[3]]]
    found += [[verb, file] for verb in ("plan", "scan", "train") for file in scans]
    found += [[verb, "--bench", file] for verb in ("devices", "doctor") for file in scans]
    found += [["evaluate", "--data", file, "--methods", "lct"] for file in data]
    found += [["calibrate", data[0], "--spots", "spots.csv"], ["calibrate", data[0], "--response", data[1]]]
    found += [
        ["methods", EVIL],
        ["patterns", EVIL],
        [EVIL],
        ["info", f"--{EVIL}"],
        ["reconstruct", data[0], "--set", EVIL],
    ]
    return found + [[verb, EVIL] for verb in sorted(set(VERBS) - {verb for verb, *_ in found})]


def test_no_verb_prints_a_command_from_a_file(evil: Path) -> None:
    words = commands()
    done = subprocess.run(
        [sys.executable, "-P", "-c", RUNS_ALL], input=json.dumps(words), cwd=evil, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    outputs = json.loads(done.stdout)
    commanding = [(given, set(text) & COMMANDING) for given, (_, text) in zip(words, outputs, strict=True)]
    assert [found for found in commanding if found[1]] == []
    assert [given for given, (code, _) in zip(words, outputs, strict=True) if code == 1] == []
    assert sum("\\x1b" in text for _, text in outputs) > 40


def test_what_is_escaped_can_still_be_read() -> None:
    assert escaped("tab\tand\nline µm Ångström 世界 \\") == "tab\tand\nline µm Ångström 世界 \\"
    assert escaped("\x1b[31m\r\u202e\udcff\U000e0041") == "\\x1b[31m\\x0d\\u202e\\xff\\U000e0041"
    assert escaped(escaped(EVIL)) == escaped(EVIL)


def test_a_stream_keeps_what_it_was() -> None:
    below = io.StringIO()
    stream = EscapedStream(below)
    print("a\x1bb", end="", file=stream, flush=True)
    assert below.getvalue() == "a\\x1bb"
    assert not stream.isatty()
    assert stream.sent is below
