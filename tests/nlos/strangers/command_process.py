"""Runs command lines as they come on stdin, each with a deadline after which this process ends; answers on stdout."""

import io
import json
import signal
import sys


def serve() -> None:
    from nlos.__main__ import run
    from nlos.acquisition.importers.isolated import one_reader
    from nlos.cli.escaped import escape_what_is_printed
    from nlos.cli.terminal import terminal

    answers, deadline_s = sys.stdout, float(sys.argv[1])
    with one_reader():
        for line in sys.stdin:
            raw = io.StringIO()
            sys.stdout = sys.stderr = raw
            escape_what_is_printed()
            terminal.document.clear()
            signal.setitimer(signal.ITIMER_REAL, deadline_s)
            code = run(json.loads(line))
            signal.setitimer(signal.ITIMER_REAL, 0)
            print(json.dumps([code, raw.getvalue()]), file=answers, flush=True)


if __name__ == "__main__":
    serve()
