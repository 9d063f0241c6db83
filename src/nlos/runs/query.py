"""What a person types to find runs again, as a condition of the index."""

from collections.abc import Sequence
from datetime import UTC, datetime

from nlos.cli.exit_codes import UsageError

UNREADABLE, OTHER = "unreadable", "other"
"""Of a recording that cannot be read; of another file that is called .h5 and is not shown."""
FIELDS = {"sample", "operator", "note", "bench", "status", "path"}
"""`sample:hat`: the word in that field alone."""


def condition(words: Sequence[str]) -> tuple[str, list[str]]:
    """SQL and its values: every word must fit. A word is part of anything that is known of a run, upper or lower case;
    `FIELD:WORD` of one field, `tag:WORD` a whole tag, `since:DAY` and `until:DAY` (2026-03 or 2026-03-01) of its start.
    Raises `UsageError` for a field that does not exist, and for what is no text."""
    clauses, values = ["1"], list[str]()
    for word in words:
        if word != word.encode("utf-8", "replace").decode("utf-8"):
            raise UsageError(f"{word!r}: is not UTF-8 text; set the terminal's encoding to UTF-8")
        field, colon, rest = word.partition(":")
        if not colon or not field.isalpha():
            clauses.append(r"(words LIKE ? ESCAPE '\' OR local_time(started) LIKE ? ESCAPE '\')")
            values += [_part(word.casefold())] * 2
        elif field in FIELDS:
            clauses.append(rf"{field} LIKE ? ESCAPE '\'")
            values.append(_part(rest))
        elif field in ("tag", "tags"):
            clauses.append(r"(' ' || tags || ' ') LIKE ? ESCAPE '\'")
            values.append(_part(f" {rest} "))
        elif field == "since":
            clauses.append("local_time(started) >= ?")
            values.append(_day(word, rest))
        elif field == "until":
            clauses.append("started != '' AND substr(local_time(started), 1, ?) <= ?")
            values += [str(len(day := _day(word, rest))), day]
        else:
            raise UsageError(f"{word}: no field of that name; known: {', '.join(sorted(FIELDS))}, tag, since, until")
    return " AND ".join(clauses), values


def _part(word: str) -> str:
    for letter in "\\%_":
        word = word.replace(letter, f"\\{letter}")
    return f"%{word}%"


def _day(word: str, text: str) -> str:
    """The day, month or year in as many digits as the index has: it is compared letter by letter."""
    for form in ("%Y-%m-%d", "%Y-%m", "%Y"):
        try:
            day = datetime.strptime(text, form)
        except ValueError:
            continue
        return day.date().isoformat()[: {"%Y": 4, "%Y-%m": 7}.get(form)]
    raise UsageError(f"{word}: write a day as 2026-03-01, a month as 2026-03, or a year")


def utc_time(text: str) -> str:
    """The moment in UTC, as the index keeps and sorts it, `2026-03-01T13:32:05+00:00`; empty where it is none. One
    without a zone is of UTC."""
    try:
        moment = datetime.fromisoformat(text)
        return moment.replace(tzinfo=moment.tzinfo or UTC).astimezone(UTC).isoformat(timespec="seconds")
    except (ValueError, OverflowError):
        return ""


def local_time(utc: str) -> str:
    """The moment as this computer's clock shows it, `2026-03-01 14:32:05`; empty where it is none."""
    try:
        return datetime.fromisoformat(utc).astimezone().isoformat(" ", "seconds")[:19]
    except (ValueError, OverflowError):
        return ""
