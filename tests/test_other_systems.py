"""What Windows lacks is used nowhere unguarded: read from the code, and every module imported without it."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.test_house_rules import TOP, files

MODULES = {"fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "syslog", "posix"}
NAMES = {
    "os": {
        "fork", "forkpty", "getuid", "geteuid", "getgid", "getpgid", "setpgid", "setsid", "killpg", "nice",
        "getpriority", "setpriority", "sched_getaffinity", "sched_setaffinity", "openpty", "ttyname", "pread",
        "pwrite", "preadv", "sync", "pwritev", "posix_fallocate", "posix_fadvise", "statvfs", "sysconf", "uname",
        "wait", "waitid", "mkfifo", "chown", "getloadavg", "fchown", "fchmod", "major", "minor", "O_NOFOLLOW",
        "O_DIRECTORY", "O_CLOEXEC",
    },
    "signal": {
        "SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGCHLD", "SIGTSTP", "SIGQUIT", "SIGSTOP",
        "SIGCONT", "SIGWINCH", "setitimer", "ITIMER_REAL", "alarm", "pause", "pthread_kill", "pthread_sigmask",
        "sigwait", "siginterrupt",
    },
    "select": {"poll", "epoll"},
    "socket": {"AF_UNIX", "SO_REUSEPORT"},
}  # fmt: skip
ELSEWHERE = {
    "drivers/link/port_lock.py": "_is_pseudo_terminal: asked only where there is a lock to take",
    "drivers/simulated/serial/pty.py": "a pseudo-terminal for other programs; Windows has none",
    "src/nlos/by_hand/light.py": "_set_timer: only where `timed` found a timer",
    "src/nlos/live/process.py": "page_process: its callers ask `check_pages` first",
}
GUARDS = ("hasattr(os", "hasattr(signal", "sys.platform", "os.name")

HIDDEN = """
import importlib, os, select, signal, socket, sys
for name in {first!r}:
    try:
        importlib.import_module(name)
    except ImportError:
        pass
for name in {modules!r}:
    sys.modules[name] = None
for module, names in {names!r}.items():
    for name in names:
        if hasattr(sys.modules[module], name):
            delattr(sys.modules[module], name)
for name in {ours!r}:
    importlib.import_module(name)
"""
FIRST = [
    "asyncio", "multiprocessing.context", "subprocess", "tempfile", "concurrent.futures", "http.server", "smtplib",
    "urllib.request", "logging.handlers", "webbrowser", "getpass", "numpy", "scipy.fft", "scipy.optimize", "scipy.io",
    "scipy.ndimage", "scipy.special", "scipy.stats", "scipy.signal", "scipy.interpolate", "scipy.sparse.linalg", "h5py",
    "yaml", "pydantic", "serial", "serial.tools.list_ports", "usb.core", "usb.backend.libusb1", "rich.progress",
    "rich.console", "typer", "typer.testing", "matplotlib.figure", "matplotlib.backends.backend_agg", "PIL.Image",
    "matplotlib.pyplot", "torch", "torch.distributed", "safetensors.torch", "distributed", "xarray",
]  # fmt: skip
"""What others make of the system is their affair: imported before anything is taken away."""


def guarded(tree: ast.Module, node: ast.AST) -> bool:
    """Whether a `try`, an `if` or the function around `node` asks whether this system has it."""
    for around in ast.walk(tree):
        inside = around is not tree and any(each is node for each in ast.walk(around))
        if not inside:
            continue
        if isinstance(around, ast.Try) and any(
            "ImportError" in ast.unparse(each.type or around) for each in around.handlers
        ):
            return True
        if isinstance(around, ast.If | ast.IfExp | ast.FunctionDef) and any(
            word in ast.unparse(around) for word in GUARDS
        ):
            return True
    return False


def unguarded() -> Iterator[str]:
    for file, tree in files():
        if file in ELSEWHERE or file.startswith("studies/"):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                named = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [str(node.module)]
                used = [name for name in named if name in MODULES]
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                used = [node.attr] if node.attr in NAMES.get(node.value.id, ()) else []
            elif isinstance(node, ast.keyword):
                used = [node.arg] if node.arg in ("pass_fds", "preexec_fn") else []
            else:
                continue
            if used and not guarded(tree, node):
                yield f"{file}:{getattr(node, 'lineno', '?')}: {', '.join(map(str, used))}"


def test_what_windows_lacks_is_asked_for_first() -> None:
    assert list(unguarded()) == []


def test_the_exceptions_still_are_some() -> None:
    for file in ELSEWHERE:
        text = (TOP / file).read_text(encoding="utf-8")
        assert any(f"{module}.{name}" in text for module, names in NAMES.items() for name in names), file


def test_every_module_is_imported_without_what_windows_lacks() -> None:
    ours = []
    for file, _ in files():
        if not file.startswith("studies/") and not file.endswith("__main__.py"):
            place = file.removeprefix("src/").removesuffix(".py").removesuffix("/__init__").replace("/", ".")
            ours.append(place if place.startswith("nlos") else f"nlos.{place}")
    code = HIDDEN.format(first=FIRST, modules=sorted(MODULES), names=NAMES, ours=ours)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=240, cwd=Path(__file__).parent
    )
    assert done.returncode == 0, done.stderr[-2000:]
