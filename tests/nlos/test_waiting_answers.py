"""An answer waits for news: whoever would ask again and again asks once, and no longer than a moment."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from urllib.request import urlopen

import pytest

from nlos.live import web
from nlos.live.web import Answer, Request, WebServer


@contextmanager
def served(nothing_new: Callable[[Request], bool], answer: Callable[[Request], Answer]) -> Iterator[str]:
    """The address of a server of its own."""
    door = socket.create_server(("127.0.0.1", 0))
    server = WebServer(door, answer, nothing_new)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield f"http://127.0.0.1:{door.getsockname()[1]}/"
    finally:
        server.stop()
        thread.join()


def test_an_answer_is_made_once_there_is_news_and_others_do_not_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "WAIT_S", 60.0)
    news, asked = threading.Event(), threading.Event()

    def nothing_new(request: Request) -> bool:
        if request.path != "/waits":
            return False
        asked.set()
        return not news.is_set()

    def answer(request: Request) -> Answer:
        return Answer(b"after the news" if news.is_set() else b"before it")

    got: list[bytes] = []
    with served(nothing_new, answer) as url:
        waiting = threading.Thread(target=lambda: got.append(urlopen(f"{url}waits").read()))
        waiting.start()
        assert asked.wait(30)
        assert urlopen(f"{url}other").read() == b"before it"
        assert got == []
        news.set()
        waiting.join(30)
    assert got == [b"after the news"]


def test_without_news_there_is_an_answer_all_the_same() -> None:
    looks: list[str] = []
    with served(lambda request: looks.append(request.path) is None, lambda request: Answer(b"as before")) as url:
        assert urlopen(f"{url}waits").read() == b"as before"
    assert len(looks) > 1
