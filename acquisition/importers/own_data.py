"""Where a user whose file is in no known format reads how to convert it."""

PAGE = "docs/howto/my-data.md"


def how_to_convert() -> str:
    """What to say to whoever's file cannot be read as it is."""
    return f"{PAGE} ('Your own MAT, NPZ or folder of CSV') shows how to convert one's own."
