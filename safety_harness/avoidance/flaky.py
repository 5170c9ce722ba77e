"""Is an avoider a function of its question and seed?  After a run it is asked everything once more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking import Answer, Question, ask
from safety_harness.avoidance.avoider import Avoider, Vector
from safety_harness.exceptions import FlakyAvoiderError
from safety_harness.scenario.faults import AvoiderNaN
from safety_harness.trace.records import FAULT_CHARACTERS, Check
from safety_harness.trace.trace import Trace


def refuse_flaky(avoider: Avoider, trace: Trace) -> None:
    """Ask ``avoider`` again what it was asked in ``trace``: FlakyAvoiderError unless the bits are the same.

    Answers that came too late, and those that a simulated fault spoilt, are left out.
    """
    spoilt = sum(1 << k for k, fault in enumerate(trace.scenario.faults) if isinstance(fault, AvoiderNaN))
    for number, decision in enumerate(trace.decisions):
        if int(decision["proposed_failed"]) & Check.LATE:
            continue
        if int(trace.ticks["faults"][int(decision["tick"])]) & spoilt:
            continue
        hand_in_base_m, tcp_in_base_m = question_of(trace, decision)
        limit_s = trace.scenario.settings.clock.wall_limit_s
        answer = ask(avoider, Question(hand_in_base_m, tcp_in_base_m, int(decision["seed"]), limit_s))
        if not _same(decision, answer):
            raise FlakyAvoiderError(_difference(trace, number, decision, answer))


def question_of(trace: Trace, decision: np.void) -> tuple[Vector, Vector]:
    """The hand and the TCP (3,) that the avoider was asked about, which may have been some ticks before."""
    if decision["asked_tick"] == decision["tick"]:
        return decision["hand_position_in_base_m"], decision["tcp_position_in_base_m"]
    tick = trace.ticks[int(decision["asked_tick"])]
    tcp_in_base_m = tick["transform_tcp_to_base"][:3, 3].copy()
    hands_in_base_m = tick["predicted_hand_in_base_m"][tick["track_valid"]]
    nearest = int(np.argmin(np.linalg.norm(hands_in_base_m - tcp_in_base_m, axis=1)))
    return hands_in_base_m[nearest], tcp_in_base_m


def _same(decision: np.void, answer: Answer) -> bool:
    position_m, spread_m = decision["proposed_position_in_base_m"], decision["proposed_spread_m"]
    return (
        position_m.tobytes() == answer.proposal.position_in_base_m.tobytes()
        and spread_m.tobytes() == answer.proposal.spread_m.tobytes()
        and str(decision["fault"]) == answer.fault[:FAULT_CHARACTERS]
    )


def _difference(trace: Trace, number: int, decision: np.void, answer: Answer) -> str:
    first = _words(decision["proposed_position_in_base_m"], decision["proposed_spread_m"], decision["fault"])
    second = _words(answer.proposal.position_in_base_m, answer.proposal.spread_m, answer.fault)
    return (
        f"the avoider {trace.provenance.avoider!r} answers the same question in two ways\n"
        f"  decision  {number + 1} of {len(trace.decisions)}, at {float(decision['time_s']):.3f} s of "
        f"{trace.scenario.name}, with the seed {int(decision['seed'])}\n"
        f"  first     {first}\n"
        f"  again     {second}\n"
        "  hint      randomness has to come from the seed that propose is given, and an answer may not\n"
        "            depend on earlier questions: no run of such an avoider can be repeated"
    )


def _words(position_m: NDArray[np.float64], spread_m: NDArray[np.float64], fault: object) -> str:
    if fault:
        return str(fault)
    shown = ", ".join(f"{value * 1e3:.9g}" for value in position_m)
    spread = ", ".join(f"{value * 1e3:.9g}" for value in spread_m)
    return f"({shown}) mm" + (f", spread ({spread}) mm" if np.any(spread_m) else "")
