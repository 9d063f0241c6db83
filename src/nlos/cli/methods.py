"""`nlos methods`: the catalogue of reconstruction methods."""

from nlos.cli.terminal import terminal


def methods() -> None:
    """Every reconstruction method, one line each."""
    from nlos.recon.methods import catalogue

    found = catalogue()
    width = max(map(len, found))
    for name, line in found.items():
        terminal.result(f"{name:<{width}}  {line}")
    terminal.document["methods"] = found
