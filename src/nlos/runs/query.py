"""What a person types to find runs again, as a condition of the index."""

from collections.abc import Sequence
from datetime import datetime

from nlos.cli.exit_codes import UsageError

UNREADABLE, OTHER = "unreadable", "other"
"""Of a recording that cannot be read; of another file that is called .h5 and is not shown."""
FIELDS = {"sample", "operator", "note", "bench", "status", "path"}
"""`sample:hat`: the word in that field alone."""


def condition(words: Sequence[str]) -> tuple[str, list[str]]:
    """SQL and its values: every word must fit. A word is part of anything that is known of a run, upper or lower case;
    `FIELD:WORD` of one field, `tag:WORD` a whole tag, `since:DAY` and `until:DAY` (2026-03 or 2026-03-01) of its start.
    Raises `UsageError` for a field that does not exist."""
    clauses, values = ["1"], []
    for word in words:
        field, colon, rest = word.partition(":")
        if not colon or not field.isalpha():
            clauses.append(r"words LIKE ? ESCAPE '\'")
            values.append(_part(word.casefold()))
        elif field in FIELDS:
            clauses.append(rf"{field} LIKE ? ESCAPE '\'")
            values.append(_part(rest))
        elif field in ("tag", "tags"):
            clauses.append(r"(' ' || tags || ' ') LIKE ? ESCAPE '\'")
            values.append(_part(f" {rest} "))
        elif field == "since":
            clauses.append("started >= ?")
            values.append(_day(word, rest))
        elif field == "until":
            clauses.append("started != '' AND substr(started, 1, ?) <= ?")
            values += [str(len(_day(word, rest))), rest]
        else:
            raise UsageError(f"{word}: no field of that name; known: {', '.join(sorted(FIELDS))}, tag, since, until")
    return " AND ".join(clauses), values


def _part(word: str) -> str:
    for letter in "\\%_":
        word = word.replace(letter, f"\\{letter}")
    return f"%{word}%"


def _day(word: str, text: str) -> str:
    for form in ("%Y-%m-%d", "%Y-%m", "%Y"):
        try:
            datetime.strptime(text, form)
        except ValueError:
            continue
        return text
    raise UsageError(f"{word}: write a day as 2026-03-01, a month as 2026-03, or a year")


def local_time(utc: str) -> str:
    """The moment as this computer's clock showed it, `2026-03-01 14:32:05`; empty where it is none."""
    try:
        return datetime.fromisoformat(utc).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    except ValueError:
        return ""
