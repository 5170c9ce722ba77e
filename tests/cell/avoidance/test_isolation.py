"""A user's avoider in a process of its own: whatever it does there, a fault in words is all that we see."""

from __future__ import annotations

import gc
import logging
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from threading import Timer

import numpy as np
import pytest

from safety_harness.base.exceptions import InadmissibleError, NoAnswerError, Place, SimulationError
from safety_harness.cell.avoidance import asking
from safety_harness.cell.avoidance.asking import Answer, Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.cell.avoidance.gate import Query, ask_many
from safety_harness.cell.avoidance.isolation import isolated
from safety_harness.cell.avoidance.isolation.isolated import IsolatedAvoider, isolated_avoider
from safety_harness.search.confirm import OtherDraws

HERE = np.array([0.7, 0.0, 0.35])
HAND = np.array([0.9, 0.1, 0.3])
HEAD = """
import ctypes, os, random, signal, sys, threading, time
import numpy as np
from safety_harness import Proposal
class Mine:
    name = "mine"
    asked = 0
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        self.asked += 1
        if seed % 10 == 1:
"""
TAIL = """
        return Proposal(2.0 * tcp_position_in_base_m - hand_position_in_base_m, [0.0, 0.0, self.asked])
"""
GOOD, BAD = 0, 1  # seeds; 11, 21 and so on are bad too
Make = Callable[..., IsolatedAvoider]
Plain = Callable[[], IsolatedAvoider]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """An avoider that does something bad when it is asked with a bad seed; its spread counts questions."""

    def made(bad: str = "pass", *, more: str = "", before: str = "") -> IsolatedAvoider:
        body = "".join(f"            {line}\n" for line in bad.splitlines())
        file = tmp_path / "mine.py"
        file.write_text(before + HEAD + body + TAIL + more)
        return isolated_avoider(file, "Mine", Place(field="--avoider"))

    return made


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Plain:
    """Avoiders that do nothing bad, of one file, which has one process for tests that follow each other."""
    file = tmp_path_factory.mktemp("plain") / "mine.py"
    file.write_text(HEAD + "            pass\n" + TAIL)
    return lambda: isolated_avoider(file, "Mine", Place(field="--avoider"))


def asked(avoider: Avoider, seed: int = GOOD, limit_s: float = 30.0) -> Answer:
    return ask(avoider, Question(HAND, HERE, seed, limit_s))


def count(answer: Answer) -> int:
    """The how manieth question it was to this object."""
    assert answer.fault == ""
    return int(answer.proposal.spread_m[2])


def query(seed: int) -> Query:
    return Query(HAND, HERE, np.eye(4), np.zeros(6), HAND[None], seed)


def alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def gone_soon(process: int) -> bool:
    until = time.monotonic() + 10.0
    while alive(process) and time.monotonic() < until:
        time.sleep(0.01)
    return not alive(process)


def test_an_answer_has_the_bits_that_it_has_at_home(plain: Plain) -> None:
    answer = asked(plain(), seed=2**64 - 1)
    assert answer.proposal.position_in_base_m.tobytes() == (2.0 * HERE - HAND).tobytes()
    assert answer.proposal.position_in_base_m.dtype == np.float64
    assert answer.latency_s > 0.0
    assert np.isnan(answer.spread_threshold_m)


def test_each_avoider_of_a_file_has_a_memory_of_its_own(plain: Plain) -> None:
    first, second = plain(), plain()
    assert [count(asked(first)) for _ in range(3)] == [1, 2, 3]
    assert count(asked(second)) == 1


def test_a_fork_of_ours_has_a_process_of_its_own(plain: Plain) -> None:
    avoider = plain()
    assert count(asked(avoider)) == 1
    fork = os.fork()
    if fork == 0:
        code = 9
        try:
            code = count(asked(avoider))  # anew: its first question once more, then this one
            gc.collect()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]) == 2
    assert count(asked(avoider)) == 2


def test_what_is_no_answer_there_is_none_here(plain: Plain, monkeypatch: pytest.MonkeyPatch) -> None:
    avoider = plain()
    sent = Answer(Proposal(np.array([np.inf, 0.0, 0.0]), np.zeros(3)))
    monkeypatch.setattr(avoider, "_answered", lambda *args, **kwargs: iter([sent]))
    assert "not finite" in avoider.answers([Question(HAND, HERE, 0, 1.0)], together=False)[0].fault


def test_a_threshold_that_changes_is_the_one_of_the_question(make: Make) -> None:
    avoider = make("self.spread_threshold_m = 0.25", more="    spread_threshold_m = 0.5\n")
    assert avoider.spread_threshold_m == 0.5
    assert asked(avoider).spread_threshold_m == 0.5
    assert asked(avoider, BAD).spread_threshold_m == 0.5  # looked at before it is asked
    assert asked(avoider).spread_threshold_m == 0.25


def test_its_memory_lasts_as_long_as_its_process(make: Make) -> None:
    avoider = make("os._exit(3)")
    assert [count(asked(avoider)) for _ in range(3)] == [1, 2, 3]
    assert asked(avoider, BAD).fault == "its process ended with exit status 3"
    assert count(asked(avoider)) == 2  # anew: its first question once more, then this one


ENDS = {
    "os._exit(0)": "its process ended with exit status 0",
    "os.kill(os.getpid(), signal.SIGKILL)": "its process was ended by SIGKILL",
    "ctypes.string_at(0)": "its process was ended by SIGSEGV",
    "os.abort()": "its process was ended by SIGABRT",
    "os.closerange(3, 1000)": "its process ended with exit status 1",
    "for fd in range(3, 1024):\n    try: os.write(fd, b'x' * 100)\n    except OSError: pass": (
        "its process answered nonsense"
    ),
}


def each_in_turn(number: str, bad: Iterable[str]) -> str:
    """What does the k-th of ``bad`` where ``number`` is k."""
    return "\n".join(
        f"if {number} == {k}:\n" + "\n".join(f"    {line}" for line in one.splitlines())
        for k, one in enumerate(bad)
    )


def test_a_process_that_ends_is_a_fault_of_that_decision_alone(make: Make) -> None:
    avoider = make(each_in_turn("seed // 10", ENDS))
    for k, fault in enumerate(ENDS.values()):
        answer = asked(avoider, 10 * k + BAD)
        assert answer.fault == fault
        assert not answer.late
        assert np.isnan(answer.proposal.position_in_base_m).all()
        assert count(asked(avoider)) == 1


SURVIVED = {
    "sys.exit(3)": "SystemExit: 3 (mine.py:11)",
    "raise KeyboardInterrupt": "KeyboardInterrupt (mine.py:11)",
    "raise BaseException('own')": "BaseException: own (mine.py:11)",
    "bytearray(1 << 36)": "MemoryError (mine.py:11)",
    "return Proposal(np.zeros(1 << 28, np.int8))": (
        "the proposed position must have shape (3,); got (268435456,)"
    ),
    "return Proposal([[1, 2], 3, 4])": "the proposed position is no array of numbers: ",
    "return [0.7, 0.0, 0.3]": "an avoider must return a Proposal; got list",
    "raise ValueError('\\n\\x1b[31m' * 10_000_000)": "ValueError: ?[31m ?[31m",
    "return Proposal(np.full(3, np.nan))": "the proposed position is not finite: [nan, nan, nan]",
    "def deep(): deep()\ndeep()": "RecursionError: maximum recursion depth exceeded (mine.py:11)",
}


def test_what_it_raises_or_returns_is_told_and_its_process_goes_on(make: Make) -> None:
    avoider = make(each_in_turn("self.asked - 1", SURVIVED))
    faults = [asked(avoider, BAD).fault for _ in SURVIVED]
    for said, expected in zip(faults, SURVIVED.values(), strict=True):
        assert said.partition(" (mine.py:")[0].startswith(expected.partition(" (mine.py:")[0])
        assert len(said) < 1_200
        assert said.isprintable()
        assert ("(mine.py:" in expected) == ("(mine.py:" in said) or expected.startswith("ValueError")
    assert count(asked(avoider)) == len(SURVIVED) + 1


def written(file: Path) -> str:
    """What a process has written there by now; a file may be there before its text."""
    return file.read_text() if file.exists() else ""


STUBBORN = "while True:\n    try: time.sleep(60)\n    except BaseException: pass"


def test_what_hangs_is_killed_with_all_that_it_forked_and_ends_the_run(make: Make, tmp_path: Path) -> None:
    avoider = make(
        f"if os.fork() == 0: open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\n" + STUBBORN
    )
    with pytest.raises(NoAnswerError, match=r"the avoider 'mine' gave no answer within 0\.5 s of wall time"):
        asked(avoider, BAD, limit_s=0.5)
    assert gone_soon(int(written(tmp_path / "pid")))
    assert count(asked(avoider)) == 1


def test_a_fork_that_comes_back_answers_nothing(make: Make) -> None:
    avoider = make("os.fork()")
    assert [count(asked(avoider, BAD)) for _ in range(3)] == [1, 2, 3]
    assert count(asked(avoider)) == 4


def test_what_it_prints_is_said_once_and_never_mixed_with_ours(
    make: Make, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = "for k in range(100_000): print('line\\x1b', k, flush=True)\nos.write(2, b'err')"
    with caplog.at_level(logging.WARNING):
        avoider = make(bad, before="print('imported')")
        assert count(asked(avoider, BAD)) == 1
        assert count(asked(avoider, BAD)) == 2
    executes, *said = [record.getMessage() for record in caplog.records]
    assert executes.startswith("executes ")
    assert said[:2] == ["mine.py wrote: imported", "mine.py wrote: line? 0"]
    assert said[-1] == "mine.py wrote more lines, here omitted"
    assert len(said) == 6
    assert capfd.readouterr().out == ""


def test_what_it_changes_stays_there(make: Make) -> None:
    bad = "np.random.seed(3); random.seed(3); np.seterr(all='raise')\nhand_position_in_base_m[:] = 9.0"
    avoider, hand = make(bad + "\nos.environ['X'] = '1'; sys.path.clear()"), HAND.copy()
    random.seed(7)
    before = random.getstate(), np.geterr(), dict(os.environ), list(sys.path)
    assert asked(avoider, BAD).fault == ""
    assert (random.getstate(), np.geterr(), dict(os.environ), list(sys.path)) == before
    np.testing.assert_array_equal(HAND, hand)


def test_an_avoider_that_cannot_be_made_again_ends_the_run_in_words(make: Make, tmp_path: Path) -> None:
    flag = str(tmp_path / "flag")
    before = f"import os\nif os.path.exists({flag!r}): os._exit(5)\nopen({flag!r}, 'w').close()\n"
    avoider = make("os._exit(3)", before=before)
    assert asked(avoider, BAD).fault == "its process ended with exit status 3"
    with pytest.raises(SimulationError, match=r"'mine' could not start again: .* exit status 5"):
        asked(avoider)
    Path(flag).unlink()
    assert count(asked(avoider)) == 1


def test_many_questions_go_in_one_message_and_a_fault_is_that_of_its_own_question(make: Make) -> None:
    avoider = make("os._exit(3)")
    seeds = [0, 0, 1, 0, 1, 0]
    answers = ask_many([avoider] * 6, [query(seed) for seed in seeds])
    assert [answer.fault != "" for answer in answers] == [seed == BAD for seed in seeds]
    assert all(answer.latency_s > 0.0 for answer in answers)


def test_one_that_takes_many_takes_them_there(make: Make) -> None:
    more = """
    def propose_many(self, hands_in_base_m, tcps_in_base_m, seeds):
        if (seeds == 2).any():
            os._exit(3)
        return tcps_in_base_m + 0.5, np.full((len(seeds), 3), 0.125)
"""
    avoider = make("os._exit(3)", more=more)
    assert avoider.takes_many
    together = ask_many([avoider] * 300, [query(0)] * 300)
    assert {float(answer.proposal.spread_m[0]) for answer in together} == {0.125}
    assert np.isnan([answer.latency_s for answer in together]).all()
    in_turn = ask_many([avoider] * 3, [query(0), query(2), query(1)])
    assert [answer.fault != "" for answer in in_turn] == [False, False, True]
    assert count(in_turn[1]) == 3  # in a new process: its first question once more, then two in turn


def test_within_a_wrapper_the_wall_limit_of_the_question_holds(make: Make) -> None:
    avoider = make(STUBBORN)
    assert count(asked(OtherDraws(avoider, 1))) == 1
    sleepy = make("pass", more="Mine.propose = lambda s, **k: time.sleep(60)\n")
    with pytest.raises(NoAnswerError, match=r"within 0\.3 s of wall time"):
        asked(OtherDraws(sleepy, 1), limit_s=0.3)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_what_it_declares_is_known_of_it_and_what_is_no_time_is_refused(make: Make) -> None:
    assert make().decision_time_s == 0.0
    assert make(more="    decision_time_s = 0.09\n").decision_time_s == 0.09
    with pytest.raises(InadmissibleError, match="a decision_time_s that is a time, if any"):
        make(more="    decision_time_s = -1.0\n")


def test_ctrl_c_passes_and_the_next_question_gets_its_own_answer(make: Make) -> None:
    avoider = make(STUBBORN)
    Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        asked(avoider, BAD)
    assert count(asked(avoider)) == 1


def test_it_does_not_outlive_us(make: Make, tmp_path: Path) -> None:
    make(f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\n" + STUBBORN)
    program = f"""
import numpy as np
from pathlib import Path
from safety_harness.cell.avoidance.isolation.isolated import isolated_avoider
from safety_harness.base.exceptions import Place
avoider = isolated_avoider(Path({str(tmp_path / "mine.py")!r}), "Mine", Place())
avoider.propose(hand_position_in_base_m=np.ones(3), tcp_position_in_base_m=np.ones(3), seed=1)
"""
    ours = subprocess.Popen([sys.executable, "-c", program])
    until = time.monotonic() + 30.0
    while not (said := written(tmp_path / "pid")) and time.monotonic() < until:
        time.sleep(0.01)
    ours.kill()
    ours.wait()
    assert gone_soon(int(said))


def test_its_process_ends_when_nobody_needs_it(make: Make, tmp_path: Path) -> None:
    bad = f"open({str(tmp_path)!r} + f'/pid{{self.asked}}', 'w').write(str(os.getpid()))"
    processes = []
    for k in range(4):  # a few are kept for the next of the same file
        avoider = make(bad, before=f"# {k}")
        asked(avoider, BAD)
        processes.append(int((tmp_path / "pid1").read_text()))
        del avoider
    gc.collect()
    assert gone_soon(processes[0])
    assert alive(processes[-1])


def test_a_file_that_ends_the_process_of_others_costs_them_their_memory_alone(make: Make) -> None:
    first = make(before="import os, sys\nif os.environ.get('ENDS'): os._exit(4)\n")
    assert count(asked(first)) == 1
    os.environ["ENDS"] = "1"
    try:
        first._connection.end()
        with pytest.raises(InadmissibleError, match="ended with exit status 4"):
            make(before="import os, sys\nif os.environ.get('ENDS'): os._exit(4)\n")
    finally:
        del os.environ["ENDS"]
    assert count(asked(first)) == 2


def test_many_asked_together_that_hang_are_asked_in_turn_and_end_the_run(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asking, "EACH_S", 0.1)
    more = "    def propose_many(self, hands_in_base_m, tcps_in_base_m, seeds): time.sleep(60)\n"
    avoider = make(STUBBORN, more=more)
    limited = [replace(query(seed), limit_s=0.5) for seed in (GOOD, BAD)]
    with pytest.raises(NoAnswerError):
        ask_many([avoider] * 2, limited)
    assert count(ask_many([avoider], [replace(query(GOOD), limit_s=0.5)])[0]) == 1


def test_a_file_that_is_never_imported_is_refused(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolated, "PROGRAM_S", 1.0)
    with pytest.raises(InadmissibleError, match="to give an avoider Mine within 1 s; got its time was over"):
        make(before="import time\nwhile True: time.sleep(1)\n")
