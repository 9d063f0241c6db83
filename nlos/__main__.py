"""`nlos`, and `python -m nlos`: runs a verb and turns every error into a sentence and an exit code."""

import sys
import traceback

from nlos.terminal import take_global_options, terminal


def main() -> None:
    """Runs the command line of this process and exits with its code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Runs one command; returns its exit code."""
    try:
        rest, version = take_global_options(arguments)
    except ValueError as error:
        terminal.log(f"nlos: {error}", -9)
        return 2
    if version:
        from nlos.version import __version__

        print(f"nlos {__version__}")
        return 0

    from nlos.app import app

    try:
        returned = app(rest, standalone_mode=False)
        terminal.finish()
        return int(returned or 0)
    except SystemExit as stop:
        return int(stop.code or 0) if isinstance(stop.code, int | None) else 1
    except BaseException as error:
        return report(error)


def report(error: BaseException) -> int:
    """Says what went wrong on stderr (and in the JSON document); returns the exit code."""
    from nlos.exit_codes import ExitCode, exit_code

    shown = getattr(error, "show", None)
    if callable(shown) and hasattr(error, "exit_code"):
        shown()
        return int(error.exit_code)
    if type(error).__name__ == "Exit" and hasattr(error, "exit_code"):
        return int(error.exit_code)
    code = ExitCode.INTERRUPTED if type(error).__name__ == "Abort" else exit_code(error)
    if code == ExitCode.BUG:
        traceback.print_exception(error)
        terminal.log("nlos: this is a bug; please report it with the lines above.", -9)
    else:
        terminal.log(f"nlos: {str(error) or code.name.lower()}", -9)
        for note in getattr(error, "__notes__", ()):
            terminal.log(f"nlos: {note}", -9)
        if terminal.verbosity > 0:
            traceback.print_exception(error)
    terminal.document["error"] = {"message": str(error), "kind": type(error).__name__, "exit_code": int(code)}
    terminal.finish()
    return int(code)


if __name__ == "__main__":
    main()
