"""Answers of a `nlos new bench` that did not end in a file: beside where that was to be, to be offered again."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from nlos.whole_file import whole_file


class Unfinished:
    """On the disk after every answer, so that Ctrl-C, a closed terminal or a power cut loses none. No verb takes the
    file for a bench's. `kind`: answers for a real bench are not offered for a simulated one."""

    def __init__(self, output: Path, kind: str) -> None:
        self.path, self._kind = output.with_name(f"{output.name}.answers"), kind

    def load(self) -> dict[str, str]:
        """Question -> answer; empty where there is nothing, or nothing that can be read."""
        try:
            said = json.loads(self.path.read_text("utf-8"))
            if said["bench"] == self._kind:
                return {str(key): str(value) for key, value in said["answers"].items()}
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            pass
        return {}

    def keep(self, answers: Mapping[str, str]) -> None:
        """All so far; a folder that takes no file ends no questions."""
        if not answers:
            self.forget()
            return
        with suppress(OSError):
            self.path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError), whole_file(self.path) as partial:
            partial.write_text(json.dumps({"bench": self._kind, "answers": dict(answers)}, indent=1) + "\n", "utf-8")

    def forget(self) -> None:
        """The bench file is there."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
