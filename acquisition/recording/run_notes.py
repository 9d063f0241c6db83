"""What a person says about a run: the sample, who measured, a note, tags. Kept in the recording's header."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

LONGEST = {"sample": 200, "operator": 200, "note": 10_000}
MOST_TAGS, LONGEST_TAG = 32, 60


@dataclass(frozen=True)
class RunNotes:
    """Texts as given; `tags` sorted, each once. Raises `ValueError` for what a recording does not keep."""

    sample: str = ""
    operator: str = ""
    note: str = ""
    tags: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, most in LONGEST.items():
            if len(getattr(self, name)) > most:
                raise ValueError(f"{name} has {len(getattr(self, name))} letters; {most} at most")
        if len(self.tags) > MOST_TAGS:
            raise ValueError(f"{len(self.tags)} tags; {MOST_TAGS} at most")
        for name, text in (*((name, getattr(self, name)) for name in LONGEST), *(("tag", tag) for tag in self.tags)):
            if any("\ud800" <= letter <= "\udfff" for letter in text):
                raise ValueError(f"{name} {text!r}: is not UTF-8 text; set the terminal's encoding to UTF-8")
        for tag in self.tags:
            if not tag or len(tag) > LONGEST_TAG or any(letter.isspace() or letter == "," for letter in tag):
                raise ValueError(f"tag {tag!r}: a tag is one word of at most {LONGEST_TAG} letters, without commas")

    @classmethod
    def of(cls, sample: str = "", operator: str = "", note: str = "", tags: Sequence[str] = ()) -> "RunNotes":
        """With spaces around texts, and tags given twice, removed."""
        return cls(sample.strip(), operator.strip(), note.strip(), tuple(sorted({tag.strip() for tag in tags})))

    def to_json(self) -> str:
        return json.dumps(asdict(self), ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> "RunNotes":
        """What a header holds; what it does not hold is empty. Raises `ValueError` where it is something else."""
        said: Any = json.loads(text)
        if not isinstance(said, dict) or not isinstance(said.get("tags", []), list):
            raise ValueError("notes are a JSON object with a list of tags")
        return cls(**{name: str(said.get(name, "")) for name in LONGEST}, tags=tuple(map(str, said.get("tags", []))))

    def shown(self) -> dict[str, str]:
        """What is said, by name, for pages and tables."""
        words = {"sample": self.sample, "operator": self.operator, "note": self.note, "tags": ", ".join(self.tags)}
        return {name: text for name, text in words.items() if text}


NO_NOTES = RunNotes()
