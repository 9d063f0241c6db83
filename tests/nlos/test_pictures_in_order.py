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


def test_who_is_told_that_a_core_is_free_finds_it_free() -> None:
    told, found = threading.Event(), list[bool]()
    aside = InOrder(1, lambda: (found.append(aside.full), told.set()))
    aside.begin(lambda: 1, lambda made: None)
    assert told.wait(60)
    assert found == [False]
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


def shown(hurry: Hurry, pictures: int, in_time: bool = True) -> list[bool]:
    """Whether each of so many successive pictures was made with less; none was dropped."""
    hurried = []
    for _ in range(pictures):
        hurried.append(hurry.next())
        hurry.shown(0, hurried[-1], in_time)
    return hurried


def test_in_a_hurry_single_pictures_are_tried_with_all_and_rarer_each_time_they_take_too_long() -> None:
    hurry = Hurry()
    tries = [number for number, hurried in enumerate(shown(hurry, 500, in_time=False)) if not hurried]
    assert tries == [(2**k - 1) * FIRST_TRY + k - 1 for k in range(1, 6)]
    assert hurry.on


def test_a_hurry_is_over_once_a_picture_with_all_is_made_in_time_and_the_next_try_comes_later() -> None:
    hurry = Hurry()
    for tries in (FIRST_TRY, 2 * FIRST_TRY, 4 * FIRST_TRY):
        assert shown(hurry, tries + 10) == [True] * tries + [False] * 10
        hurry.shown(1, False, False)


def test_while_a_try_is_being_made_the_next_pictures_hurry_and_a_frame_it_drops_ends_it() -> None:
    hurry = Hurry()
    shown(hurry, FIRST_TRY)
    assert [hurry.next() for _ in range(3)] == [False, True, True]
    hurry.shown(0, True, True)  # one that was begun before
    hurry.shown(1, False, True)
    assert shown(hurry, 1) == [True]
