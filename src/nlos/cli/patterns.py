"""`nlos patterns`: the catalogue of scan patterns."""

from nlos.cli.terminal import terminal


def patterns() -> None:
    """Every scan pattern, one line each."""
    from nlos.acquisition.planning.patterns import PATTERNS

    found = {word: (settings.__doc__ or "").partition("\n")[0] for word, settings in sorted(PATTERNS.items())}
    width = max(map(len, found))
    for word, line in found.items():
        terminal.result(f"{word:<{width}}  {line}")
    terminal.document["patterns"] = found
