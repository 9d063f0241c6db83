"""Pictures of a film are made side by side and shown in order; in a hurry they are made with less."""

import threading

import numpy as np
import pytest

from nlos.live.hurry import FIRST_TRY, Hurry
from nlos.live.in_order import InOrder
from nlos.recon.transport.fourier import each, on_one_core, threads


def test_pictures_are_made_at_the_same_time_and_shown_in_the_order_in_which_they_were_begun() -> None:
    shown: list[int] = []
    second = threading.Event()
    aside = InOrder(2)

    def first_picture() -> int:
        assert second.wait(60)  # so the second one is being made meanwhile, and done before
        return 1

    def second_picture() -> int:
        second.set()
        return 2

    assert not aside.full
    aside.begin(first_picture, shown.append)
    assert not aside.full
    aside.begin(second_picture, shown.append)
    aside.finish()
    assert shown == [1, 2]
    aside.stop()


def test_what_a_picture_raises_is_raised_where_the_next_is_asked_for_and_keeps_no_other_back() -> None:
    shown: list[int] = []
    aside = InOrder(2)
    aside.begin(lambda: 1 // 0, shown.append)
    aside.begin(lambda: 2, shown.append)
    with pytest.raises(ZeroDivisionError):
        aside.finish()
    aside.stop()
    assert shown == [2]


def test_no_more_pictures_are_begun_than_there_are_cores() -> None:
    go_on, aside = threading.Event(), InOrder(2)
    for _ in range(2):
        assert not aside.full
        aside.begin(lambda: go_on.wait(60), lambda made: None)
    assert aside.full
    go_on.set()
    aside.finish()
    assert not aside.full
    aside.stop()


def test_on_one_core_blocks_are_computed_in_this_thread_and_elsewhere_as_before() -> None:
    used: set[int] = set()
    ready = np.zeros(1)
    before, elsewhere = threads(), []
    with on_one_core():
        assert threads() == 1
        each(lambda item: used.add(threading.get_ident()), range(8), ready)
        assert used == {threading.get_ident()}
        with on_one_core():
            pass
        assert threads() == 1
    assert threads() == before
    thread = threading.Thread(target=lambda: elsewhere.append(threads()))
    thread.start()
    thread.join()
    assert elsewhere == [before]


def test_a_hurry_begins_with_a_dropped_frame_and_is_left_on_trial_for_longer_each_time() -> None:
    hurry = Hurry()
    hurry.shown(0)
    assert not hurry.on
    for tries in (FIRST_TRY, 2 * FIRST_TRY):
        hurry.shown(3)
        assert hurry.on
        for _ in range(tries - 1):
            hurry.shown(0)
            assert hurry.on
        hurry.shown(0)
        assert not hurry.on
