"""Is an avoider a function of its question and seed?  It is asked once more what a run asked it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import FlakyAvoiderError
from safety_harness.cell.avoidance.asking import Answer, Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector, shown_to
from safety_harness.scenario.faults import AvoiderNaN
from safety_harness.trace.records import FAULT_CHARACTERS, Check
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class Asked:
    """A question of a run and the avoider's answer to it; ``number`` is its decision's, counted from 1."""

    run: str
    number: int
    question: Question
    answer: Answer


def asked_in(trace: Trace) -> list[Asked]:
    """What the avoider was asked in a run, and answered; the trace knows each question exactly.

    Answers that came too late, and those that a simulated fault spoilt, are left out.
    """
    spoilt = sum(1 << k for k, fault in enumerate(trace.scenario.faults) if isinstance(fault, AvoiderNaN))
    limit_s = trace.scenario.settings.clock.wall_limit_s
    found = []
    for number, decision in enumerate(trace.decisions, start=1):
        if int(decision["proposed_failed"]) & Check.LATE:
            continue
        if spoilt and int(trace.ticks["faults"][int(decision["tick"])]) & spoilt:
            continue
        question = Question(*question_of(trace, decision), int(decision["seed"]), limit_s)
        proposal = Proposal(decision["proposed_position_in_base_m"], decision["proposed_spread_m"])
        answer = Answer(proposal, float(decision["spread_threshold_m"]), str(decision["fault"]))
        found.append(Asked(trace.scenario.name, number, question, answer))
    return found


def refuse_flaky(avoider: Avoider, trace: Trace) -> None:
    """Ask ``avoider`` again what it was asked in ``trace``; FlakyAvoiderError for other bits.

    One that sees more is not: no trace keeps all that it saw.
    """
    if shown_to(avoider):
        return
    for one in asked_in(trace):
        answer = ask(avoider, one.question)
        if difference(one.answer, answer):
            raise FlakyAvoiderError(_difference(trace, one, answer))


def difference(first: Answer, again: Answer) -> str:
    """What an avoider did otherwise when it was asked again, in words; empty for the same bits.

    A fault's words count as far as a trace keeps them.
    """
    position_m, again_m = first.proposal.position_in_base_m, again.proposal.position_in_base_m
    spread_m, other_m = first.proposal.spread_m, again.proposal.spread_m
    fault, other = first.fault[:FAULT_CHARACTERS], again.fault[:FAULT_CHARACTERS]
    if fault != other:
        return f"it answered {other or 'with a position'!r}, not {fault or 'with a position'!r}"
    if position_m.tobytes() != again_m.tobytes():
        return f"it answered {np.linalg.norm(again_m - position_m) * 1e3:.3g} mm elsewhere"
    if spread_m.tobytes() != other_m.tobytes():
        return f"its spread was {np.abs(other_m - spread_m).max() * 1e3:.3g} mm otherwise"
    if not np.array_equal(first.spread_threshold_m, again.spread_threshold_m, equal_nan=True):
        return "its spread threshold was another"
    return ""


def question_of(trace: Trace, decision: np.void) -> tuple[Vector, Vector]:
    """The hand and the TCP (3,) that the avoider was asked about, which may have been some ticks before."""
    if decision["asked_tick"] == decision["tick"]:
        return decision["hand_position_in_base_m"], decision["tcp_position_in_base_m"]
    tick = trace.ticks[int(decision["asked_tick"])]
    tcp_in_base_m = tick["transform_tcp_to_base"][:3, 3].copy()
    hands_in_base_m = tick["predicted_hand_in_base_m"][tick["track_valid"]]
    nearest = int(np.argmin(np.linalg.norm(hands_in_base_m - tcp_in_base_m, axis=1)))
    return hands_in_base_m[nearest], tcp_in_base_m


def _difference(trace: Trace, one: Asked, answer: Answer) -> str:
    first, second = _words(one.answer), _words(answer)
    time_s = float(trace.decisions["time_s"][one.number - 1])
    return (
        f"the avoider {trace.system.tested.name!r} answers the same question in two ways\n"
        f"  decision  {one.number} of {len(trace.decisions)}, at {time_s:.3f} s of "
        f"{trace.scenario.name}, with the seed {one.question.seed}\n"
        f"  first     {first}\n"
        f"  again     {second}\n"
        "  hint      randomness has to come from the seed that propose is given, and an answer may not\n"
        "            depend on earlier questions: no run of such an avoider can be repeated"
    )


def _words(answer: Answer) -> str:
    if answer.fault:
        return answer.fault
    shown, spread = map(_mm, (answer.proposal.position_in_base_m, answer.proposal.spread_m))
    return f"({shown}) mm" + (f", spread ({spread}) mm" if np.any(answer.proposal.spread_m) else "")


def _mm(vector_m: NDArray[np.float64]) -> str:  # (3,)
    return ", ".join(f"{value * 1e3:.9g}" for value in vector_m)
