"""Asking an avoider: an answer or a fault, and never later than the deadline without saying so."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from safety_harness.avoidance.asking import Answer, ask
from safety_harness.avoidance.avoider import Proposal

HERE = np.array([0.7, 0.0, 0.35])


class Thinker:
    """Does something before it answers."""

    name = "a thinker"

    def __init__(self, think: Callable[[], object] = lambda: None) -> None:
        self.think = think
        self.finished = 0

    def propose(self, **question: object) -> Proposal:
        self.think()
        self.finished += 1
        return Proposal(HERE)


def answer_of(avoider: Thinker, deadline_s: float = 0.05, late: bool | None = None) -> Answer:
    return ask(
        avoider,
        hand_position_in_base_m=HERE,
        tcp_position_in_base_m=HERE,
        seed=1,
        deadline_s=deadline_s,
        late=late,
    )


def sleeps() -> None:
    time.sleep(0.2)


def holds_on() -> None:
    """Takes every interruption for its own."""
    end = time.monotonic() + 0.2
    while time.monotonic() < end:
        try:
            time.sleep(0.2)
        except BaseException:
            continue


def assert_late(answer: Answer) -> None:
    assert answer.late
    assert answer.fault == "no answer within 50 ms"
    assert np.isnan(answer.proposal.position_in_base_m).all()


def test_an_answer_in_time_comes_with_its_latency() -> None:
    answer = answer_of(Thinker(), deadline_s=60.0)
    assert not answer.late
    assert not answer.fault
    assert answer.latency_s > 0.0
    np.testing.assert_array_equal(answer.proposal.position_in_base_m, HERE)


def test_an_avoider_is_interrupted_at_the_deadline() -> None:
    def for_ever() -> None:
        while True:
            time.sleep(0.01)

    thinker = Thinker(for_ever)
    answer = answer_of(thinker)
    assert_late(answer)
    assert answer.latency_s > 0.05
    assert thinker.finished == 0


def test_an_answer_that_could_not_be_interrupted_is_thrown_away() -> None:
    thinker = Thinker(holds_on)
    assert_late(answer_of(thinker))
    assert thinker.finished == 1


def test_off_the_main_thread_a_late_answer_is_thrown_away() -> None:
    found: list[Answer] = []
    thinker = Thinker(sleeps)
    thread = threading.Thread(target=lambda: found.append(answer_of(thinker)))
    thread.start()
    thread.join()
    assert_late(found[0])
    assert thinker.finished == 1


def test_what_was_late_on_record_is_not_asked_again() -> None:
    thinker = Thinker()
    assert_late(answer_of(thinker, late=True))
    assert thinker.finished == 0


def test_what_was_in_time_on_record_is_waited_for() -> None:
    answer = answer_of(Thinker(sleeps), late=False)
    assert not answer.late
    assert answer.latency_s > 0.05


def test_a_timer_of_somebody_else_is_left_alone() -> None:
    rung: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: rung.append(number))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        assert_late(answer_of(Thinker(sleeps)))
        assert rung == [signal.SIGALRM]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_no_timer_and_no_handler_is_left_behind() -> None:
    before = signal.getsignal(signal.SIGALRM)
    answer_of(Thinker(sleeps))
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_the_interpreters_own_exits_pass(stop: type[BaseException]) -> None:
    def ends() -> None:
        raise stop

    with pytest.raises(stop):
        answer_of(Thinker(ends))
