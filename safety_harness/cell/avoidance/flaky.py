"""Ask an avoider the questions of a run again.

The answers must be the same, because an answer may depend only on its question and its seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.base.exceptions import FlakyAvoiderError
from safety_harness.cell.avoidance.asking import Answer, Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector, shown_to
from safety_harness.scenario.faults import AvoiderNaN
from safety_harness.trace.records import FAULT_CHARACTERS, Check
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class Asked:
    """A question of a run with the avoider's answer.

    ``number`` is the number of the decision in the run, counted from 1.
    """

    run: str
    number: int
    question: Question
    answer: Answer


def asked_in(trace: Trace) -> list[Asked]:
    """Return the questions and answers of a run.

    The trace stores each question without rounding. The result leaves out answers that came too late, and
    answers that a simulated fault replaced.
    """
    nan_faults = sum(1 << k for k, fault in enumerate(trace.scenario.faults) if isinstance(fault, AvoiderNaN))
    limit_s = trace.scenario.settings.clock.wall_limit_s
    questions = []
    for number, decision in enumerate(trace.decisions, start=1):
        if int(decision["proposed_failed"]) & Check.LATE:
            continue
        if nan_faults and int(trace.ticks["faults"][int(decision["tick"])]) & nan_faults:
            continue
        question = Question(*question_of(trace, decision), int(decision["seed"]), limit_s)
        proposal = Proposal(decision["proposed_position_in_base_m"], decision["proposed_spread_m"])
        answer = Answer(proposal, float(decision["spread_threshold_m"]), str(decision["fault"]))
        questions.append(Asked(trace.scenario.name, number, question, answer))
    return questions


def refuse_flaky(avoider: Avoider, trace: Trace) -> None:
    """Ask ``avoider`` the questions of ``trace`` again.

    Raise ``FlakyAvoiderError`` if any bit of an answer differs. The function skips an avoider with ``sees``,
    because a trace does not store everything that such an avoider saw.
    """
    if shown_to(avoider):
        return
    for earlier in asked_in(trace):
        answer = ask(avoider, earlier.question)
        if difference(earlier.answer, answer):
            raise FlakyAvoiderError(_difference(trace, earlier, answer))


def difference(first: Answer, again: Answer) -> str:
    """Return a description of the difference between two answers, or an empty string if all bits are equal.

    A trace keeps only the first characters of a fault's text, and the function compares only these
    characters.
    """
    position_m, again_m = first.proposal.position_in_base_m, again.proposal.position_in_base_m
    spread_m, spread_again_m = first.proposal.spread_m, again.proposal.spread_m
    fault, fault_again = first.fault[:FAULT_CHARACTERS], again.fault[:FAULT_CHARACTERS]
    if fault != fault_again:
        return f"it answered {fault_again or 'with a position'!r}, not {fault or 'with a position'!r}"
    if position_m.tobytes() != again_m.tobytes():
        return f"it answered {length(again_m - position_m) * 1e3:.3g} mm elsewhere"
    if spread_m.tobytes() != spread_again_m.tobytes():
        return f"its spread was {np.abs(spread_again_m - spread_m).max() * 1e3:.3g} mm otherwise"
    if not np.array_equal(first.spread_threshold_m, again.spread_threshold_m, equal_nan=True):
        return "its spread threshold was another"
    return ""


def question_of(trace: Trace, decision: np.void) -> tuple[Vector, Vector]:
    """Return the positions of hand and TCP in the question of a decision, each (3,).

    The question may be some ticks earlier than the decision.
    """
    if decision["asked_tick"] == decision["tick"]:
        return decision["hand_position_in_base_m"], decision["tcp_position_in_base_m"]
    tick = trace.ticks[int(decision["asked_tick"])]
    tcp_in_base_m = tick["transform_tcp_to_base"][:3, 3].copy()
    hands_in_base_m = tick["predicted_hand_in_base_m"][tick["track_valid"]]
    nearest = int(np.argmin(np.linalg.norm(hands_in_base_m - tcp_in_base_m, axis=1)))
    return hands_in_base_m[nearest], tcp_in_base_m


def _difference(trace: Trace, earlier: Asked, answer: Answer) -> str:
    """Return the text of the error that an avoider gave two different answers to a question."""
    first, second = _in_words(earlier.answer), _in_words(answer)
    time_s = float(trace.decisions["time_s"][earlier.number - 1])
    return (
        f"the avoider {trace.system.tested.name!r} answers the same question in two ways\n"
        f"  decision  {earlier.number} of {len(trace.decisions)}, at {time_s:.3f} s of "
        f"{trace.scenario.name}, with the seed {earlier.question.seed}\n"
        f"  first     {first}\n"
        f"  again     {second}\n"
        "  hint      randomness has to come from the seed that propose is given, and an answer may not\n"
        "            depend on earlier questions: no run of such an avoider can be repeated"
    )


def _in_words(answer: Answer) -> str:
    """Return an answer as text."""
    if answer.fault:
        return answer.fault
    shown, spread = map(_mm, (answer.proposal.position_in_base_m, answer.proposal.spread_m))
    return f"({shown}) mm" + (f", spread ({spread}) mm" if np.any(answer.proposal.spread_m) else "")


def _mm(vector_m: NDArray[np.float64]) -> str:  # (3,)
    """Return a vector [m] as text in mm."""
    return ", ".join(f"{value * 1e3:.9g}" for value in vector_m)
