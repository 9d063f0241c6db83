"""`nlos`, and `python -m nlos`: runs a verb and turns every error into a sentence and an exit code."""

import os
import signal
import sys

if (__name__ == "__main__" or os.path.basename(sys.argv[0]) in ("nlos", "nlos.exe")) and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    # Until `main` begins nothing is open that could be left half done, and a Ctrl-C that falls into an import is
    # printed as an error of the program, or forgotten by Python.
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    _starting = signal.getsignal(signal.SIGINT)
else:
    _starting = None

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # `python -m` puts the current folder first: a numpy.py in it is no part of this program

import traceback
from collections.abc import Sequence
from os.path import basename, isfile

from nlos.cli.escaped import escape_what_is_printed
from nlos.cli.interrupts import (
    end_at_interrupts,
    end_at_once_at_sigterm,
    end_in_order_at_sigterm,
    ignore_interrupts,
    never_lose_an_interrupt,
)
from nlos.cli.outliving import outlive_terminal, refused_results
from nlos.cli.terminal import show_library_log, take_global_options, terminal
from nlos.cli.threads_left import end_within
from nlos.drivers.exit_paths import was_told_to_end
from nlos.recon.control_group import granted

_OUTPUTS = ("-o", "--output")
_MOST_NAMED = 3
_STORAGE = 6
_BY_SIGNAL, _INTERRUPTED, _TERMINATED = 128, 130, 143
_MOST_BEHIND = 100


def main() -> None:
    """Runs the command line of this process and exits with its code."""
    # PyTorch's threads wait for each other asleep, not spinning: a machine that scans has other things to do, and where
    # two of these threads share a core, spinning takes ten times as long as the work (decision 095).
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    # NumPy's and SciPy's OpenBLAS, each with threads of its own, hands out even matrices of 2 x 2, and spins meanwhile:
    # a Delaunay mesh of a thousand points took 5 ms of one core, or seconds of two that were shared (decision 305).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A container's share of processor time is not among the processors that OpenMP counts.
    if "OMP_NUM_THREADS" not in os.environ and (many := granted()):
        os.environ["OMP_NUM_THREADS"] = str(many)
    # Nor do the children of this process, however a library starts them, import from the current folder.
    os.environ["PYTHONSAFEPATH"] = "1"
    outlive_terminal()
    escape_what_is_printed()
    try:
        never_lose_an_interrupt()
        if _starting is not None and signal.getsignal(signal.SIGINT) is _starting:
            end_at_interrupts()
        try:
            code = run(sys.argv[1:])
        finally:
            ignore_interrupts()
    except KeyboardInterrupt:  # also one that came when all was done
        ignore_interrupts()
        code = 130
    end_at_once_at_sigterm()
    code = code_of_results(code)
    end_within(code)
    sys.exit(code)


def code_of_results(code: int) -> int:
    """The exit code of a command that would end with `code`: another where its work is done and its results are not in
    the file that they were sent to, which is said."""
    refused = refused_results()
    if refused is None:
        return code
    terminal.log(
        f"nlos: standard output: write error: {refused.strerror}. What was printed there is not whole; all else is as "
        "this command left it. Free disk space, or send the output elsewhere.", -9,
    )  # fmt: skip
    return code or _STORAGE


def run(arguments: list[str]) -> int:
    """Runs one command; returns its exit code."""
    show_library_log()
    try:
        rest, version = take_global_options(arguments)
    except ValueError as error:
        from nlos.cli.exit_codes import UsageError

        return report(UsageError(str(error)), arguments)
    if version:
        from nlos.version import __version__

        terminal.result(f"nlos {__version__}", version=__version__)
        terminal.finish()
        return 0

    if terminal.as_json:
        end_in_order_at_sigterm()
    from nlos.cli.app import app

    if "_NLOS_COMPLETE" in os.environ:  # a shell asks what may come next: see `nlos completion`
        from typer._completion_classes import completion_init

        completion_init()
    try:
        with terminal.results_alone():
            code = int(app(rest, standalone_mode=False) or 0)
        if code == _INTERRUPTED:  # what typer makes of a Ctrl-C
            return ended_by_signal(KeyboardInterrupt(), code)
        terminal.finish()
        return code
    except SystemExit as stop:
        ignore_interrupts()
        code = int(stop.code or 0) if isinstance(stop.code, int | None) else 1
        if code > _BY_SIGNAL:
            return ended_by_signal(stop, code)
        terminal.finish()
        return code
    except BaseException as error:
        ignore_interrupts()  # it ends: a second Ctrl-C has nothing to add
        return report(error, rest)


def report(error: BaseException, words: Sequence[str] = ()) -> int:
    """Says what went wrong on stderr (and in the JSON document), of which of the files that the command names; returns
    the exit code."""
    from nlos.cli.exit_codes import ExitCode, Stopped, exit_code, missing_package

    shown = getattr(error, "show", None)
    if callable(shown) and hasattr(error, "exit_code"):
        if isinstance(said := getattr(error, "message", None), str):
            error.message = said.replace("Value error, ", "")  # type: ignore[attr-defined]  # pydantic's own words
        shown()
        return ended(str(error), error, int(error.exit_code))
    if type(error).__name__ == "Exit" and hasattr(error, "exit_code"):
        return int(error.exit_code)
    code = ExitCode.INTERRUPTED if type(error).__name__ == "Abort" else exit_code(error)
    message = missing_package(error) or told_by_system(error) or str(error)
    if isinstance(error, MemoryError):
        message = f"the memory is not enough{f' ({message})' if message else ''}. Close what else runs, or take less."
    if code == ExitCode.BUG and (was_told_to_end() or follows_an_interrupt(error)):  # what a library made of it
        code, message = ExitCode.INTERRUPTED, ""
    if code == ExitCode.DATA and not getattr(error, "names_files", False):
        message = with_its_file(message, words)
    if code == ExitCode.BUG:
        traceback.print_exception(error)
        terminal.log("nlos: this is a bug; please report it with the lines above.", -9)
    else:
        terminal.log(f"nlos: {message or code.name.lower()}", -9)
        for note in getattr(error, "__notes__", ()):
            terminal.log(f"nlos: {note}", -9)
        if terminal.verbosity > 0 and not isinstance(error, Stopped):  # which has said all there is to say
            traceback.print_exception(error)
    return ended(message, error, int(code))


def told_by_system(error: BaseException) -> str:
    """What the operating system says of a file or folder, as a sentence with what to do; empty for other errors."""
    if not isinstance(error, OSError) or None in (error.errno, error.filename) or not str(error).startswith("["):
        return ""
    from nlos.acquisition.recording.disk_refusal import remedy

    named = error.filename if isinstance(error.filename, str | bytes) else str(error.filename)
    return f"{os.fsdecode(named)}: {error.strerror}. {remedy(error)}"


def follows_an_interrupt(error: BaseException) -> bool:
    """Whether a Ctrl-C is behind it: a library that it broke into says so in an error of its own."""
    behind: list[BaseException | None] = [error]
    for each in behind:
        if isinstance(each, KeyboardInterrupt):
            return True
        if each is not None and len(behind) < _MOST_BEHIND:
            behind += [each.__cause__, each.__context__]
    return False


def with_its_file(message: str, words: Sequence[str]) -> str:
    """What is wrong with data, said of the files that a command was given where it names none of them."""
    files = [word for word, before in zip(words, ["", *words], strict=False) if before not in _OUTPUTS and isfile(word)]
    if not files or any(basename(each) in message for each in files):
        return message
    more = f" and {len(files) - _MOST_NAMED} more" if len(files) > _MOST_NAMED else ""
    return f"{', '.join(files[:_MOST_NAMED])}{more}: {message}"


def ended_by_signal(error: BaseException, code: int) -> int:
    """Says that a signal ended the command, unless it said so itself; returns the exit code."""
    if not terminal.end_said:
        terminal.say_end({_INTERRUPTED: "interrupted", _TERMINATED: "terminated"}.get(code, "ended by a signal"))
    return ended(terminal.end_said, error, code)


def ended(message: str, error: BaseException, code: int) -> int:
    """The same in the JSON document; returns the exit code."""
    terminal.document["error"] = {"message": message, "kind": type(error).__name__, "exit_code": code}
    terminal.finish()
    return code


if __name__ == "__main__":
    main()
