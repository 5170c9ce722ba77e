"""Judge the avoider's own proposals before the gate, because a good gate hides a bad avoider.

Each answer is compared with the question to which it belongs. A decision time or a fault may delay the tick
at which the controller uses an answer. The proposal is then still compared with the hand and the TCP at the
tick of the question. A missing answer is not a proposal; the claim "the avoider answered" judges missing
answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.flaky import question_of
from safety_harness.cell.avoidance.measures import gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.claims.properties.base import (
    Evaluation,
    Property,
    Unit,
    Worded,
    is_somewhere,
    judged,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import no_answer, spread_beside_threshold
from safety_harness.trace.known import OF_DECISIONS
from safety_harness.trace.overruling import Overruling, answered, overruled
from safety_harness.trace.records import ENDLESS
from safety_harness.trace.trace import Trace, once_a_trace

QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m")
ANSWER = ("decision.time_s", "decision.proposed_position_in_base_m", "decision.fault")
PROPOSAL = (
    *ANSWER,
    *(f"{OF_DECISIONS}{name}" for name in QUESTION),
    "decision.tick",
    "decision.asked_tick",
    "transform_tcp_to_base",  # this and the next two are read at the tick of the question, if that is another
    "track_valid",
    "predicted_hand_in_base_m",
)
SURENESS = ("decision.proposed_spread_m", "decision.spread_threshold_m")


@once_a_trace
def proposals(trace: Trace) -> NDArray[np.void]:
    """Return the usable answers as (m,) DECISION.

    In each record, the hand and the TCP are replaced by those at the time of the question. An answer to an
    earlier question is omitted if the trace has no tracked hand at the time of that question.
    """
    answers: NDArray[np.void] = trace.decisions[answered(trace)]  # a copy
    seen = (answers["asked_tick"] == answers["tick"]) | trace.ticks["track_valid"][answers["asked_tick"]].any(
        axis=1
    )
    answers = answers[seen]
    for answer in answers:
        for name, position in zip(QUESTION, question_of(trace, answer), strict=True):
            answer[name] = position if is_somewhere(position) else np.nan
    return answers


def as_told(trace: Trace, margin: float) -> tuple[float, float, bool]:
    """Return the bounds of the margin for ``reads``.

    Both bounds are ``margin`` if the margin is exact, and otherwise the bounds are infinite. The margin is
    not exact if a question was asked before the tick of its decision, or if a column of the decisions is
    uncertain.
    """
    decisions, known = trace.decisions, trace.known
    own = bool((decisions["asked_tick"] == decisions["tick"]).all())
    if not own or known.uncertain([name for name in (*PROPOSAL, *SURENESS) if name.startswith(OF_DECISIONS)]):
        return -np.inf, np.inf, False
    return margin, margin, True


def optima_in_base_m(trace: Trace, proposals: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the closed-form optimum for each question of ``proposals`` (m,), shape (m, 3)."""
    hands, tcps = proposals["hand_position_in_base_m"], proposals["tcp_position_in_base_m"]
    return np.asarray(optimum_in_base_m(trace.scenario.settings, hands, tcps))


def worst(
    prop: Property,
    trace: Trace,
    proposals: NDArray[np.void],  # (m,)
    margins_m: NDArray[np.float64],  # (m,)
    shown_m: NDArray[np.float64],  # (m,)
    meaning: str,
) -> Evaluation:
    """Judge the proposal with the least margin, or the first proposal whose margin is NaN.

    The reason shows the proposal's ``shown_m`` in mm, followed by its ``meaning``.
    """
    if len(proposals) == 0:
        return unexercised(prop, no_answer(trace))
    at = int(np.argmin(margins_m))  # the first NaN, if there is one
    reason = f"{shown_m[at] * 1e3:.1f} mm {meaning}" + (
        f", worst of {len(proposals)}" if len(proposals) > 1 else ""
    )
    return judged(prop, trace, float(margins_m[at]), float(proposals["time_s"][at]), reason, len(proposals))


@dataclass(frozen=True, kw_only=True)
class ProposalsLeadAway(Worded):
    """The claim that the straight way from the TCP to a proposal leads away from the hand.

    Both the TCP and the hand are those at the tick of the question. The margin is the component of this way
    that leads away from the hand, plus the tolerance. For the proposal p, the TCP t and the hand h, this
    component is the scalar product of p - t and (t - h)/|t - h|. A question contains only the nearest hand.
    The gate and the claim "repulsion moves away from every hand" consider all hands.
    """

    tolerance_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "proposals lead away to within {tolerance_m:mm}"

    @reads(also=PROPOSAL, ends=lambda prop, trace, margin: as_told(trace, margin))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every proposal."""
        answers = proposals(trace)
        away_m = gained_m(
            answers["hand_position_in_base_m"],
            answers["tcp_position_in_base_m"],
            answers["proposed_position_in_base_m"],
        )
        return worst(self, trace, answers, away_m + self.tolerance_m, away_m, "away from the hand")


@dataclass(frozen=True, kw_only=True)
class NearOptimum(Worded):
    """The claim that each proposal lies within ``within_m`` of the closed-form optimum of its question."""

    within_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "proposals within {within_m:mm} of the optimum"

    @reads(also=PROPOSAL, ends=lambda prop, trace, margin: as_told(trace, margin))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every proposal."""
        answers = proposals(trace)
        error_m = off_m(answers["proposed_position_in_base_m"], optima_in_base_m(trace, answers))
        return worst(self, trace, answers, self.within_m - error_m, error_m, "from the optimum")


@dataclass(frozen=True, kw_only=True)
class WithinSpread(Worded):
    """The claim that each proposal lies near the optimum in comparison with its spread.

    On each axis, the distance from the optimum may be ``spreads`` times the spread plus an allowance. The
    margin of a proposal p is the least of k s_i + allowance - |p_i - o_i| over the axes i. Here k is
    ``spreads``, s is the spread and o is the optimum. The allowance covers the noise of the labels from which
    the network learnt. The spread of dropout passes or of ensemble members does not include this noise.
    """

    spreads: float
    allowance_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "proposals within {spreads:1} spread(s) and {allowance_m:mm} of the optimum"

    @reads(also=[*PROPOSAL, *SURENESS], ends=lambda prop, trace, margin: as_told(trace, margin))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every proposal on each axis.

        The verdict is inconclusive if the avoider gives no spread.
        """
        answers = proposals(trace)
        spread_m = np.minimum(answers["proposed_spread_m"], ENDLESS)
        if len(answers) and np.isnan(answers["spread_threshold_m"]).all() and not (spread_m > 0.0).any():
            return unexercised(self, "the avoider gives no spread; one that does exercises it")
        errors_m = np.abs(answers["proposed_position_in_base_m"] - optima_in_base_m(trace, answers))  # (m, 3)
        margins_m = self.spreads * spread_m + self.allowance_m - errors_m
        axis = np.argmin(margins_m, axis=1)[:, None]
        margin_m, error_m = (np.take_along_axis(each, axis, axis=1)[:, 0] for each in (margins_m, errors_m))
        return worst(self, trace, answers, margin_m, error_m, "from the optimum along an axis")


@dataclass(frozen=True, kw_only=True)
class NeverSureAndOff(Worded):
    """The claim that every sure proposal is within ``within_m`` of the optimum of its question.

    The optimum is computed in closed form. A proposal is *sure* if its largest spread is at most the
    avoider's own threshold. If the avoider has no threshold, every proposal is sure.
    """

    within_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "proposals never sure and more than {within_m:mm} from the optimum"

    @reads(also=[*PROPOSAL, *SURENESS], ends=lambda prop, trace, margin: as_told(trace, margin))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every sure proposal."""
        answers = proposals(trace)
        sure = answers[is_sure(answers["proposed_spread_m"], answers["spread_threshold_m"])]
        if len(answers) and not len(sure):
            return unexercised(self, spread_beside_threshold(trace, above=False))
        error_m = off_m(sure["proposed_position_in_base_m"], optima_in_base_m(trace, sure))
        return worst(self, trace, sure, self.within_m - error_m, error_m, "from the optimum, and sure")


@dataclass(frozen=True, kw_only=True)
class FewOverruled(Worded):
    """The claim that the gate overrules at most the fraction ``most`` of a run's proposals.

    The gate overrules a proposal if it replaces it by the opposite pose or by a stop. The claim includes
    every answer that came in time, even if a fault of the scenario delayed the answer so that its question is
    old.
    """

    most: float
    unit: Unit = Unit.FRACTION
    wording: ClassVar[str] = "at most {most:%} of proposals overruled"

    @reads(also=[*ANSWER, "decision.outcome"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the fraction of overruled proposals in the whole run."""
        made, vetoed = answered(trace), overruled(trace)
        proposed, count = int(np.count_nonzero(made)), int(np.count_nonzero(vetoed))
        if proposed == 0:
            return unexercised(self, no_answer(trace))
        reasons_known = not trace.known.missing(["decision.proposed_failed"])
        reasons = Overruling.from_traces([trace]).reasons if reasons_known else {}
        why = ", ".join(f"{check.name} {n}" for check, n in reasons.items()).lower().replace("_", " ")
        reason = f"{count} of {proposed} overruled" + (f" ({why})" if why else "")
        time_s = float(trace.decisions["time_s"][int(np.argmax(vetoed if count else made))])
        return judged(self, trace, self.most - count / proposed, time_s, reason, proposed, revocable=True)


YARDSTICK = (
    "The optimum is the closed form of the function that the networks learn (eq. 13 with "
    "the continuous optimum). The optimum is only a yardstick, because an avoider of "
    "another kind may be good although its proposals are far from it"
)
ANSWERED = "the controller queried the avoider and got a usable answer"
OPTIMUM_OF = "the length; radius, candidate cone, hand pull, nominal hand and desired pose in the settings"

LEAD_AWAY = CatalogueEntry(
    prop=ProposalsLeadAway(tolerance_m=0.01),
    rationale=(
        "an avoider may propose positions towards a hand although the gate refuses them all, "
        "and the arm's motion does not show this"
    ),
    source='the paper, section 4.1 ("a quarter of a sphere will lead the robot to move away")',
    margin=(
        "the component of the path from the TCP to the proposal that leads away from the "
        "queried hand, plus the tolerance; the least value over proposals"
    ),
    parameters="the tolerance, by which a proposal may lead nearer to the hand",
    exercised=ANSWERED,
    broken_by="an avoider that proposes positions towards the hand, behind the full gate",
)
NEAR_OPTIMUM = CatalogueEntry(
    prop=NearOptimum(within_m=0.06),
    pattern=r"proposals within (\S+(?: \S+)?) of the optimum",
    rationale="this claim detects a network that is wrong in a region, a frame or a unit before any other "
    f"claim does. {YARDSTICK}",
    source="eq. 13 of the paper, with the nearest point of the candidates' cap in closed form",
    margin=(
        "the length minus the distance from a proposal to the optimum for the same query; the "
        "least value over proposals"
    ),
    parameters=OPTIMUM_OF,
    exercised=ANSWERED,
    scenario="network-certain",
    broken_by="an avoider that proposes a position two metres away",
)
WITHIN_SPREAD = CatalogueEntry(
    prop=WithinSpread(spreads=3.0, allowance_m=0.03),
    rationale="the gate trusts the spread, so it passes an error with a small spread. The spread of "
    "dropout or of an ensemble does not contain the noise of the labels; the allowance covers this noise. "
    f"{YARDSTICK}",
    source="the paper, section 3.3, and eqs. 10 and 11: the spread of a network's answers",
    margin=(
        "for each axis, the number times the spread, plus the allowance, minus the distance "
        "to the optimum along that axis. The margin is the least value over axes and "
        "proposals"
    ),
    parameters="the number of spreads; the allowance; the settings that determine the optimum",
    exercised=ANSWERED,
    inconclusive="an avoider without a threshold whose spreads are all zero, because it states no "
    "uncertainty",
    scenario="network-certain",
    broken_by="an avoider that has a threshold and is sure of a position far from the optimum",
)
NEVER_SURE_AND_OFF = CatalogueEntry(
    prop=NeverSureAndOff(within_m=0.06),
    rationale="an uncertain answer leads to the fallback, so errors matter most where the network "
    f"is certain. {YARDSTICK}",
    source="the paper, section 3.3: the arm uses the opposite pose if the network is not sure",
    margin=(
        "the length minus the distance from a proposal to the optimum for the same query; the "
        "least value over the proposals whose largest spread is at most the avoider's "
        "threshold"
    ),
    parameters=f"{OPTIMUM_OF}; the avoider's threshold (an avoider without a threshold is always sure)",
    exercised=f"{ANSWERED} of which the avoider was sure",
    scenario="network-certain",
    broken_by="an avoider that has a threshold and is sure of a position far from the optimum",
)
FEW_OVERRULED = CatalogueEntry(
    prop=FewOverruled(most=0.5),
    rationale=(
        "the runs should assess the avoider, but if the gate overrules the avoider, the runs "
        "show only the fallback"
    ),
    source="the three steps of the gate: answer, opposite pose, stop",
    margin=(
        "the allowed percentage minus the percentage of a run's proposals that the gate "
        "replaced or answered with a stop"
    ),
    parameters="the allowed percentage, from 0 % to less than 100 %",
    exercised=ANSWERED,
    broken_by="an avoider with a spread above its threshold at every query",
)
