"""Files that appear together: what is left of them where the program is ended while it writes them."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

WRITES = """
import sys, time
from pathlib import Path
from nlos.recon.whole_files import whole_files

with whole_files(Path(sys.argv[1])) as partial:
    (partial / "picture.png").write_bytes(b"half")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("there_before", [False, True])
def test_sigterm_while_files_are_written_leaves_what_was_there(tmp_path: Path, there_before: bool) -> None:
    folder = tmp_path / "made"
    if there_before:
        folder.mkdir()
        (folder / "picture.png").write_bytes(b"whole")
    with subprocess.Popen([sys.executable, "-c", WRITES, str(folder)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
        writer.send_signal(signal.SIGTERM)
        assert writer.wait(30) == 128 + signal.SIGTERM
    assert [path.name for path in tmp_path.rglob("*")] == (["made", "picture.png"] if there_before else [])
    assert not there_before or (folder / "picture.png").read_bytes() == b"whole"
