"""Names as words of files: readable ones for runs, and those of a bench that no other name shares."""

import hashlib
import re


def file_word(text: str) -> str:
    """A text as part of a file's name: letters of any language, digits, dots and underscores, joined by dashes."""
    return re.sub(r"[^\w.]+", "-", text).strip("-.")[:60]


def cut(word: str, most_bytes: int) -> str:
    """Its beginning that fits into a name: disks count bytes, and letters of many languages have several."""
    return word.encode("utf-8", "replace")[:most_bytes].decode("utf-8", "ignore")


def own_word(name: str) -> str:
    """The same of a bench's name, and no other name's: where the word says it otherwise, a hash of the name ends it."""
    word = file_word(name)
    if word == name:
        return word
    ending = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{word}-{ending}" if word else ending


def older_word(name: str) -> str:
    """What earlier versions called a bench's files: several benches share it, so whoever reads them asks whose."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name)[:60]
