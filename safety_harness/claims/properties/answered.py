"""Judge that the avoider itself answers, and in time; otherwise the fallback acts in its place.

"the avoider answered" is the only claim that is judged in every run, even if its scenario does not make it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, judged, time_left_s
from safety_harness.claims.properties.entry import CatalogueEntry, quantity
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import no_decision
from safety_harness.scenario.fault_table import TIME_EPS_S
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN, AvoiderSilent
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.units import TIME
from safety_harness.trace.records import ENDLESS, Check
from safety_harness.trace.trace import Trace

_MEASURED = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")
_NUMBER = re.compile(r"(?<![\w.-])(?<!\.py:)(?<!status )-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?!\w|\.\d)")
NOT_MODELLED = "computing time not modelled"


@dataclass(frozen=True, kw_only=True)
class AvoiderAnswered:
    """Minus the number of questions without a usable answer.

    An exception, an invalid proposal, a NaN, a late answer or an ended process counts as no answer. An answer
    that the gate refuses still counts as an answer. A question does not count if a fault of the scenario kept
    the avoider from answering.
    """

    unit: Unit = Unit.COUNT
    sentence: str = "the avoider answered"

    @reads(
        also=[
            "faults",
            "decision.tick",
            "decision.time_s",
            "decision.proposed_position_in_base_m",
            "decision.proposed_failed",
            "decision.fault",
        ]
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge whether each question got a usable answer."""
        own, silent = _own(trace), unanswered(trace)
        questions, missing = int(np.count_nonzero(own)), int(np.count_nonzero(silent))
        if questions == 0:
            return unexercised(self, self._never_asked(trace))
        first = int(np.argmax(silent if missing else own))
        why = f"; first: {_fault_text(trace, first)}" if missing else ""
        reason = f"{missing} of {questions} questions without a usable answer{why}"
        return judged(self, trace, -missing, trace.decisions["time_s"][first], reason, exercised=questions)

    def _never_asked(self, trace: Trace) -> str:
        suppressed = len(trace.decisions)
        if suppressed == 0:
            return no_decision(trace)
        return f"answers that a fault of the scenario kept away: all {suppressed}; another one exercises it"


def unanswered(trace: Trace) -> NDArray[np.bool_]:
    """Return (m,) the decisions without a usable answer that no fault of the scenario explains."""
    decisions = trace.decisions
    if len(decisions) == 0:
        return np.zeros(0, np.bool_)
    none: NDArray[np.bool_] = decisions["fault"] != ""
    none |= ~(np.abs(decisions["proposed_position_in_base_m"]) < ENDLESS).all(axis=1)
    return none & _own(trace)


def fault_of(trace: Trace) -> str:
    """Return words on the avoider's first failure to answer; empty if it always answered.

    The text has no numbers, so that equal faults give equal texts.
    """
    if len(trace.decisions) == 0 or not (silent := unanswered(trace)).any():
        return ""
    return f"the avoider gave no answer: {_MEASURED.sub('...', _fault_text(trace, int(np.argmax(silent))))}"


def without_numbers(text: str) -> str:
    """Return ``text`` without numbers, except those in names, line numbers of files and exit codes."""
    return _NUMBER.sub("...", text)


def fallback_words(unanswered: int, decisions: int) -> str:
    """Return a headline on how often the avoider gave no usable answer; empty if it always answered."""
    if not unanswered:
        return ""
    never = "did not answer" if unanswered == decisions else "did not always answer"
    made = f"{unanswered:,} of {decisions:,} {'decision' if decisions == 1 else 'decisions'}"
    return f"the avoider {never}: with the fallback in its place in {made}"


def _own(trace: Trace) -> NDArray[np.bool_]:
    """Return (m,) the questions whose answer no fault of the scenario suppresses.

    The trace marks such a fault at the decision's tick. An answer that by itself takes longer than the
    deadline is late, whatever fault acts.
    """
    if not trace.scenario.faults:
        return np.ones(len(trace.decisions), np.bool_)
    slow = nan = 0
    for k, fault in enumerate(trace.scenario.faults):
        slow |= (1 << k) * isinstance(fault, AvoiderLate | AvoiderSilent)
        nan |= (1 << k) * isinstance(fault, AvoiderNaN)
    decisions, count = trace.decisions, len(trace.ticks)
    acted = np.append(trace.ticks["faults"], 0)[np.clip(decisions["tick"], 0, count)]  # of any trace at all
    late = decisions["proposed_failed"] & Check.LATE != 0
    if not trace.known.missing(["decision.decision_time_s"]):
        deadline_s = trace.scenario.settings.avoidance.decision_deadline_s + TIME_EPS_S
        late &= ~(decisions["decision_time_s"] > deadline_s)
    own: NDArray[np.bool_] = ~((acted & nan != 0) | (late & (acted & slow != 0)))
    return own


def _fault_text(trace: Trace, number: int) -> str:
    return str(trace.decisions["fault"][number]) or "a position that is not finite"


ANSWERED = CatalogueEntry(
    prop=AvoiderAnswered(),
    rationale="if the avoider does not answer, the fallback acts in its place, and every verdict is "
    "about the fallback. Every run is therefore judged by this claim. A scenario that does not contain it "
    "expects it to hold",
    source="the seam of the avoider: one proposal of finite numbers for each question, in time",
    margin="minus the number of questions without a usable answer (the avoider raised an exception, "
    "returned NaN or something other than a proposal, answered too late, or its process ended); at 0 the "
    "claim holds",
    parameters="the decision deadline of the settings",
    exercised="the controller asked the avoider while no fault of the scenario prevented an answer",
    broken_by="an avoider that raises an exception at every question",
)
DEFAULT_CLAIM = Claim(sentence=ANSWERED.example, expected=Verdict.HOLDS)


def is_claimed(claims: Iterable[Claim]) -> bool:
    """Return whether ``claims`` include "the avoider answered"."""
    return any(ANSWERED.understands(claim.sentence) for claim in claims)


def with_expectation(claims: tuple[Claim, ...], scenario: Scenario) -> tuple[Claim, ...]:
    """Return ``claims`` and, unless they include it, the scenario's own claim on answers."""
    if is_claimed(claims):
        return claims
    return claims + tuple(claim for claim in scenario.claims if is_claimed([claim]))


def by_default(trace: Trace) -> Evaluation | None:
    """Return the evaluation of a run that lacks answers although the scenario expects them; else None."""
    expected = (c.expected for c in trace.scenario.claims if ANSWERED.understands(c.sentence))
    if next(expected, Verdict.HOLDS) is not Verdict.HOLDS:
        return None
    evaluation = AvoiderAnswered().evaluate(trace)
    return evaluation if evaluation.verdict is Verdict.VIOLATED else None


@dataclass(frozen=True, kw_only=True)
class DecisionTime(Worded):
    """The least over decisions of ``within_s`` less the time for which the arm moved without the answer.

    That time lasts until the tick at which the answer counts. It is the decision time of the settings or of
    the avoider's declaration, plus a delay by a fault of the scenario. An answer that missed the deadline
    counts as at least one control period later than the limit. If a decision takes no simulated time, it is
    not evidence, and the claim cannot hold.
    """

    within_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "decisions within {within_s:ms}"

    @reads(
        also=[
            "decision.tick",
            "decision.time_s",
            "decision.asked_tick",
            "decision.decision_time_s",
            "decision.proposed_failed",
        ]
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the time of each decision."""
        decisions, period_s = trace.decisions, trace.scenario.settings.clock.control_period_s
        if len(decisions) == 0:
            return unexercised(self, f"{no_decision(trace)} if the settings have a decision time")
        took = decisions["tick"] - decisions["asked_tick"]
        late = (decisions["proposed_failed"] & Check.LATE) != 0
        left_s = np.array([time_left_s(trace, self.within_s, int(ticks)) for ticks in took])
        left_s = np.where(late, np.minimum(left_s, -period_s), left_s)
        worst = int(np.argmin(left_s))
        free = ~late & (decisions["decision_time_s"] == 0.0)
        if free.any() and not left_s[worst] < 0.0:
            return inconclusive(self, f"{NOT_MODELLED}; a decision time in the settings exercises it")
        reason = (
            f"slowest {took[worst] * period_s * 1e3:.1f} ms, median {np.median(took) * period_s * 1e3:.1f} ms"
        )
        if late.any():
            reason = f"{np.count_nonzero(late)} of {len(late)} were never answered"
        exercised = int(np.count_nonzero(~free | (left_s < 0.0)))
        return judged(self, trace, left_s[worst], decisions["time_s"][worst], reason, exercised)


DECISION_TIME_CLAIM = CatalogueEntry(
    prop=DecisionTime(within_s=0.1),
    pattern=r"decisions within (.+)",
    make=lambda match, _, place: DecisionTime(within_s=quantity(match[1], TIME, place)),
    rationale="the hand moves while the avoider computes. The avoider declares how long a decision "
    "takes, or a profile contains measured times. No run here shows whether the avoider keeps these times "
    "on the robot's own computer",
    source="the reaction time T_r, in which all has to fit",
    margin="the limit less the longest simulated time from a question to the tick at which the "
    "controller uses the answer. If the controller gave up on an answer, the time is at least one control "
    "period longer than the limit",
    parameters="the limit; the decision time and the decision deadline of the settings",
    exercised="the controller made a decision that takes simulated time",
    inconclusive="a decision that takes no simulated time, because its computing time is not modelled",
    scenario="decisions-take-90-ms",
    broken_by="an avoider that never answers",
)
