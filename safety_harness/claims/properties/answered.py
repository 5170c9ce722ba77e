"""Check that the avoider itself answers in time, because the fallback acts in place of a missing answer.

The claim "the avoider answered" is judged in every run, even if the scenario does not contain it; no other
claim is judged in this way.
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
    """The claim that the avoider gave a usable answer to each question.

    The margin is minus the number of questions without a usable answer. An exception, an invalid proposal, a
    NaN, a late answer or an ended process counts as no answer. An answer that the gate refuses still counts
    as an answer. Questions are ignored if a fault of the scenario kept the avoider from answering.
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
    """Return a mask of decisions, shape (m,).

    It contains the decisions without a usable answer, unless a fault of the scenario suppressed the answer.
    """
    decisions = trace.decisions
    if len(decisions) == 0:
        return np.zeros(0, np.bool_)
    none: NDArray[np.bool_] = decisions["fault"] != ""
    none |= ~(np.abs(decisions["proposed_position_in_base_m"]) < ENDLESS).all(axis=1)
    return none & _own(trace)


def fault_of(trace: Trace) -> str:
    """Return a message about the avoider's first failure to answer, or an empty text if it always answered.

    The text has no numbers, so that equal faults give equal texts.
    """
    if len(trace.decisions) == 0 or not (silent := unanswered(trace)).any():
        return ""
    return f"the avoider gave no answer: {_MEASURED.sub('...', _fault_text(trace, int(np.argmax(silent))))}"


def without_numbers(text: str) -> str:
    """Remove the numbers from ``text``, except numbers in names, line numbers of files and exit codes."""
    return _NUMBER.sub("...", text)


def fallback_words(unanswered: int, decisions: int) -> str:
    """Return a headline on how often the avoider gave no usable answer.

    The text is empty if the avoider always answered.
    """
    if not unanswered:
        return ""
    never = "did not answer" if unanswered == decisions else "did not always answer"
    made = f"{unanswered:,} of {decisions:,} {'decision' if decisions == 1 else 'decisions'}"
    return f"the avoider {never}: with the fallback in its place in {made}"


def _own(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the decisions whose answer no fault of the scenario suppressed, shape (m,).

    The trace marks such a fault at the decision's tick. If the avoider itself exceeds the deadline, the
    decision is included even while such a fault is active.
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
    source="the avoider's interface: for each query, one proposal of finite numbers, in time",
    margin=(
        "minus the number of queries without a usable answer (the avoider raised an "
        "exception, returned NaN or something other than a proposal, answered too late, or "
        "its process ended). The claim holds if the margin is 0"
    ),
    parameters="the decision deadline of the settings",
    exercised="the controller queried the avoider while no fault of the scenario prevented an answer",
    broken_by="an avoider that raises an exception at every query",
)
DEFAULT_CLAIM = Claim(sentence=ANSWERED.example, expected=Verdict.HOLDS)


def is_claimed(claims: Iterable[Claim]) -> bool:
    """Return whether "the avoider answered" is among ``claims``."""
    return any(ANSWERED.understands(claim.sentence) for claim in claims)


def with_expectation(claims: tuple[Claim, ...], scenario: Scenario) -> tuple[Claim, ...]:
    """Return ``claims``, completed by the claim on answers.

    If these claims do not include a claim on answers, the scenario's own claim on answers is added.
    """
    if is_claimed(claims):
        return claims
    return claims + tuple(claim for claim in scenario.claims if is_claimed([claim]))


def by_default(trace: Trace) -> Evaluation | None:
    """Return the evaluation of "the avoider answered", or None if the run does not violate this claim.

    The result is also None if the scenario expects a verdict other than *holds*.
    """
    expected = (c.expected for c in trace.scenario.claims if ANSWERED.understands(c.sentence))
    if next(expected, Verdict.HOLDS) is not Verdict.HOLDS:
        return None
    evaluation = AvoiderAnswered().evaluate(trace)
    return evaluation if evaluation.verdict is Verdict.VIOLATED else None


@dataclass(frozen=True, kw_only=True)
class DecisionTime(Worded):
    """The claim that each answer comes within ``within_s`` of simulated time.

    For each decision, the claim measures how long the arm moved without the answer, and subtracts this time
    from ``within_s``. The margin is the least result. The time without the answer lasts until the tick at
    which the controller uses the answer. It consists of the decision time, which the settings or the avoider
    declare, and of any delay by a fault of the scenario. If an answer missed the deadline, its time is at
    least one control period longer than the limit. The claim cannot hold if a decision takes no simulated
    time, because such a decision is not evidence.
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
        """Judge the time that each decision took."""
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
    source="the reaction time T_r, which includes the decision",
    margin=(
        "the limit minus the longest simulated time from a query to the tick at which the "
        "controller uses the answer. If the controller gave up on an answer, the time is at "
        "least one control period longer than the limit"
    ),
    parameters="the limit; the decision time and the decision deadline of the settings",
    exercised="the controller made a decision that takes simulated time",
    inconclusive="a decision that takes no simulated time, because its computing time is not modelled",
    scenario="decisions-take-90-ms",
    broken_by="an avoider that never answers",
)
