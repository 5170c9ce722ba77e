"""Asking an avoider: an answer or a fault however long it takes, and an error where it never comes."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from safety_harness.base.exceptions import AvoiderError, NoAnswerError
from safety_harness.cell.avoidance.asking import Answer, Question, ask
from safety_harness.cell.avoidance.avoider import Proposal, decision_time_of

HERE = np.array([0.7, 0.0, 0.35])
HANGS = r"the avoider 'a thinker' gave no answer within 0\.05 s of wall time"


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


def answer_of(avoider: Thinker, limit_s: float = 0.05) -> Answer:
    return ask(avoider, Question(HERE, HERE, 1, limit_s))


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


def for_ever() -> None:
    while True:
        time.sleep(0.01)


def test_an_answer_comes_with_its_latency_and_counts_however_long_it_took() -> None:
    answer = answer_of(Thinker(sleeps), limit_s=60.0)
    assert (answer.fault, answer.late) == ("", False)
    assert answer.latency_s > 0.1
    np.testing.assert_array_equal(answer.proposal.position_in_base_m, HERE)


def test_one_that_hangs_is_interrupted_at_the_wall_limit_and_gives_no_answer() -> None:
    thinker = Thinker(for_ever)
    with pytest.raises(NoAnswerError, match=HANGS):
        answer_of(thinker)
    assert thinker.finished == 0


def test_what_could_not_be_interrupted_gives_no_answer_either() -> None:
    thinker = Thinker(holds_on)
    with pytest.raises(NoAnswerError, match=HANGS):
        answer_of(thinker)
    assert thinker.finished == 1


def test_off_the_main_thread_it_gives_no_answer_either() -> None:
    found: list[BaseException] = []

    def asks() -> None:
        try:
            answer_of(Thinker(sleeps))
        except NoAnswerError as error:
            found.append(error)

    thread = threading.Thread(target=asks)
    thread.start()
    thread.join()
    assert len(found) == 1


def test_an_avoider_that_asks_one_that_hangs_hangs_itself() -> None:
    def asks_another() -> None:
        raise NoAnswerError("another", 0.05)

    with pytest.raises(NoAnswerError, match="'another'"):
        answer_of(Thinker(asks_another))


def test_a_timer_of_somebody_else_is_left_alone() -> None:
    rung: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: rung.append(number))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(NoAnswerError):
            answer_of(Thinker(sleeps))
        assert rung == [signal.SIGALRM]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_no_timer_and_no_handler_is_left_behind() -> None:
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(NoAnswerError):
        answer_of(Thinker(sleeps))
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_the_interpreters_own_exits_pass(stop: type[BaseException]) -> None:
    def ends() -> None:
        raise stop

    with pytest.raises(stop):
        answer_of(Thinker(ends))


@pytest.mark.parametrize(
    ("declared", "time_s"), [(None, 0.0), (0, 0.0), (0.09, 0.09), (np.float32(0.5), 0.5), (60, 60.0)]
)
def test_what_a_decision_costs_is_what_the_avoider_declares(declared: object, time_s: float) -> None:
    thinker = Thinker()
    thinker.decision_time_s = declared  # type: ignore[attr-defined]
    assert decision_time_of(thinker) == time_s
    assert decision_time_of(Thinker()) == 0.0


@pytest.mark.parametrize("declared", [-0.01, 60.1, np.nan, np.inf, "90 ms", True, [0.09]])
def test_what_is_no_time_is_refused(declared: object) -> None:
    thinker = Thinker()
    thinker.decision_time_s = declared  # type: ignore[attr-defined]
    with pytest.raises(AvoiderError, match="decision_time_s must be a time from 0 s to 60 s, or None"):
        decision_time_of(thinker)
