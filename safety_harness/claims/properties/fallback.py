"""Judge by the arm's motion whether it falls back after uncertain answers and uses certain answers.

Further claims judge whether the fallback can be used, and whether the arm stops if it has no valid retreat
position.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length, product
from safety_harness.cell.avoidance.flaky import question_of
from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, is_somewhere, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.giving_way import LEAST_WAY_M, Finding, worst_of
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.properties.positions import opposite_position, reach_m, spare_m, stopped_m
from safety_harness.claims.properties.proposals import PROPOSAL
from safety_harness.claims.properties.way_gone import OFF_RAD, PACE, SHORT_M, way_gone
from safety_harness.claims.signals.occasions import millimetres, no_decision, spread_beside_threshold
from safety_harness.trace.known import OF_DECISIONS
from safety_harness.trace.records import Check, DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

SAME_M = 0.001  # two positions nearer to each other than this are the same
READS = (
    "joint_position_rad",
    "joint_velocity_radps",
    "transform_tcp_to_base",
    "tcp_speed_mps",
    "demanded_joint_velocity_radps",
)
ALSO = (
    "mode",
    "limits",
    "track_valid",
    "predicted_hand_in_base_m",
    "decision.tick",
    "decision.time_s",
    "decision.trigger",
    "decision.proposed_spread_m",
    "decision.spread_threshold_m",
    "decision.chosen_position_in_base_m",
)
BEYOND_DOUBT_M = 0.0002  # reach is known to 0.1 mm
USED_CYCLES = 2  # within which the arm uses a certain answer, as for an uncertain one in the catalogue
Findings = dict[str, list[Finding]]  # by the part that they judge


def has_doubt(decision: np.void) -> bool | None:
    """Return whether the spread exceeds the avoider's threshold on any axis.

    The result is None if the spread or the threshold is missing.
    """
    spread_m, threshold_m = decision["proposed_spread_m"], decision["spread_threshold_m"]
    if not (np.isfinite(spread_m).all() and np.isfinite(threshold_m)):
        return None
    return bool(spread_m.max() > threshold_m)


def outside_region(trace: Trace, decision: np.void) -> bool:
    """Return whether ``decision`` asked a question outside the gate's region."""
    region = None if trace.scenario.gate is None else trace.scenario.gate.questions_within
    return region is not None and not region.depth_m(*question_of(trace, decision)) >= 0.0


def kept_from_possible_hands(trace: Trace, decision: np.void, failed: str) -> bool:
    """Return whether the gate may have refused a position because a hand could be there.

    This is the only point at which the package trusts the gate, because no trace records the filter's
    uncertainty about its hands.
    """
    rule = trace.scenario.gate
    if rule is None or not rule.of_possible_hands:
        return False
    return trace.known.missing([OF_DECISIONS + failed]) != () or bool(decision[failed] & Check.TOWARDS_A_HAND)


def _add(findings: Findings, added: Findings) -> None:
    for part, more in added.items():
        findings[part] += more


def went(
    trace: Trace, number: int, target_in_base_m: NDArray[np.float64], cycles: int, where: str
) -> tuple[Findings, bool]:
    """Return findings on a decision's choice of a target and on the motion towards this target.

    The second result is True if the decision exercised the claim. The target is ``target_in_base_m`` (3,),
    and ``where`` describes it in the findings.
    """
    decision = trace.decisions[number]
    findings, tried = way_gone(trace, number, target_in_base_m, cycles, where)
    chosen, off_m = decision["chosen_position_in_base_m"], np.nan
    if is_somewhere(chosen) and is_somewhere(target_in_base_m):
        off_m = length(chosen - target_in_base_m)
    if off_m <= SAME_M:
        return findings, tried
    onset = f"told to go elsewhere than {where}"
    return {"choice": [Finding(SAME_M - off_m, float(decision["time_s"]), onset)], **findings}, True


def concluded(
    prop: UncertainFallsBack | CertainIsUsed,
    trace: Trace,
    finding_lists: Findings,
    exercised: int,
    none: Callable[[], str],
) -> Evaluation:
    """Return the evaluation of the worst finding, with an evaluation for each part.

    ``none`` returns the reason why there is no finding.
    """
    if not any(finding_lists.values()):
        return unexercised(prop, none())
    lacked = f"no repulsion had time for {LEAST_WAY_M * 1e3:g} mm of way; a longer duration exercises it"

    def judge(findings: list[Finding]) -> Evaluation:
        worst = worst_of(findings)
        reason = worst.what + (f", worst of {exercised} decisions" if exercised > 1 else "")
        return judged(prop, trace, worst.margin_m, worst.time_s, reason, exercised, lambda: lacked)

    parts = [
        replace(judge(own), sentence=f"{prop.sentence}: {part}") for part, own in finding_lists.items() if own
    ]
    return replace(judge([finding for own in finding_lists.values() for finding in own]), parts=tuple(parts))


@dataclass(frozen=True, kw_only=True)
class UncertainFallsBack(Worded):
    """The claim that the arm goes to the opposite pose, or stops, if the spread exceeds the threshold.

    The opposite pose is computed again from the predictions at the decision's tick. ``way_gone`` judges the
    motion's onset (within ``cycles`` control ticks), direction, speed and end separately. A chosen position
    more than 1 mm from the opposite pose is a violation. The arm may stop before the next decision if the
    opposite pose could not be used (``spare_m``). In that case, the arm must really stop (``stopped_m``). If
    the arm stops although it could have used the pose, the margin is minus the reserve of the pose
    (``spare_m``).
    """

    cycles: int
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "uncertain answers fall back within {cycles:} cycles"

    @reads(*READS, also=[*ALSO, "decision.hand_position_in_base_m"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision whose answer was uncertain."""
        findings: Findings = defaultdict(list)
        exercised = 0
        for number, decision in enumerate(trace.decisions):
            if not has_doubt(decision):
                continue
            opposite = opposite_position(trace, decision)
            tick, time_s = int(decision["tick"]), float(decision["time_s"])
            # The next decision ends this one, and has a verdict of its own.
            until = min([tick + self.cycles, *trace.decisions["tick"][number + 1 : number + 2] - 1])
            if np.any(trace.ticks["mode"][tick : until + 1] == Mode.PROTECTIVE_STOP):
                if not kept_from_possible_hands(trace, decision, "opposite_failed"):
                    lacked_m = -spare_m(trace, decision, opposite)
                    findings["stop"].append(
                        Finding(lacked_m, time_s, "stopped, what the opposite pose lacked")
                    )
                left_m = stopped_m(trace, min(until, len(trace.ticks) - 1))
                findings["stop"].append(Finding(left_m, time_s, "the way of the stop"))
                exercised += 1
                continue
            more, tried = went(trace, number, opposite, self.cycles, "the opposite pose")
            _add(findings, more)
            exercised += tried
        return concluded(self, trace, findings, exercised, lambda: spread_beside_threshold(trace, above=True))


@dataclass(frozen=True, kw_only=True)
class CertainIsUsed:
    """The claim that the arm uses each usable answer whose spread is within the avoider's threshold.

    Answers to questions outside the gate's region are ignored. This claim complements ``UncertainFallsBack``,
    because a gate that always falls back would make every avoider look safe. An answer is usable if its
    reserve (``spare_m``) is at least 1 mm. The motion to the proposed position is judged like a motion to the
    opposite pose. If the arm stops, the margin is minus the distance to the proposed position.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "certain answers are used"

    @reads(*READS, also=[*ALSO, *PROPOSAL, "decision.outcome"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision whose answer was certain and usable."""
        findings: Findings = defaultdict(list)
        exercised, kept, most_m = 0, 0, -np.inf
        for number, decision in enumerate(trace.decisions):
            proposed = decision["proposed_position_in_base_m"]
            if has_doubt(decision) is not False or outside_region(trace, decision):
                continue
            if kept_from_possible_hands(trace, decision, "proposed_failed"):
                kept += 1
                continue
            to_spare_m = spare_m(trace, decision, proposed)
            most_m = max(most_m, to_spare_m)
            if not to_spare_m >= SAME_M:
                continue
            if decision["outcome"] == DecisionOutcome.STOP:
                tcp_in_base = trace.ticks["transform_tcp_to_base"][decision["tick"], :3, 3]
                way_m = length(proposed - tcp_in_base)
                findings["stop"].append(Finding(-way_m, float(decision["time_s"]), "stopped all the same"))
                exercised += 1
                continue
            more, tried = went(trace, number, proposed, USED_CYCLES, "the proposed position")
            _add(findings, more)
            exercised += tried

        def none() -> str:
            if not np.isfinite(most_m) and kept:
                return f"the gate kept all {kept} from where a hand may be; one that it does not exercises it"
            if not np.isfinite(most_m):
                return spread_beside_threshold(trace, above=False)
            had = f"the certain answers had {millimetres(most_m, SAME_M)} to spare at most"
            return f"{had}; {SAME_M * 1e3:g} mm within reach, and away from hands and robot, exercises it"

        return concluded(self, trace, findings, exercised, none)


MARGINS = (
    f"Direction: how far the TCP stays inside a cone of {np.degrees(OFF_RAD):g} deg around the direction to "
    "the pose, after the first 10 mm. "
    f"Speed: how far the TCP is ahead of a point mass with {PACE.speed:.0%} of a repulsion's speed and "
    f"{PACE.acceleration:.0%} of its acceleration. "
    f"End: the arrival tolerance plus {SHORT_M * 1e3:g} mm, minus the TCP's distance from the pose"
)

UNCERTAIN = CatalogueEntry(
    prop=UncertainFallsBack(cycles=2),
    pattern=r"uncertain answers fall back within (\S+) cycles?",
    rationale="the spread is useful only if it prevents the arm from going where the network guesses",
    source="the paper, section 3.3: the arm uses the opposite pose if the network is not sure",
    margin="the least of four margins of a retreat. Onset: the control ticks left, converted to a distance. "
    f"{MARGINS}. After a stop: the amount by which the opposite pose failed a check, or minus its reserve if "
    "it passed",
    parameters="the number of control ticks; the avoider's threshold, and the radius in the settings",
    exercised=(
        "a spread is above the avoider's threshold, and the arm then stops or has time for a path of 10 mm"
    ),
    scenario="hesitating-reach",
    broken_by="an avoider with large spreads behind a gate that does not check the spread",
)

CERTAIN = CatalogueEntry(
    prop=CertainIsUsed(),
    rationale="if a system always falls back, the runs do not test its avoider",
    source="the paper, section 3.3: the same rule as for uncertain answers, in the other direction",
    margin="the least of four margins of a retreat. Onset: the control ticks left of two, converted to a "
    f"distance. {MARGINS}. After a stop: minus the distance to the proposed position",
    parameters="the avoider's threshold; the reserve that a position needs to be usable",
    exercised=(
        "a spread is within the avoider's threshold, the position is usable, and the arm has "
        "time for a path of 10 mm"
    ),
    scenario="hesitating-reach",
    broken_by="a gate that refuses every proposal",
)


@dataclass(frozen=True, kw_only=True)
class FallbackPoses:
    """The claim that the gate's fallback pose is reachable and leads away from hands at every decision.

    All decisions are judged, even if the system did not fall back. The first part is judged in the same way
    as the claim ``repulsive poses reachable``, beginning at the true joint positions. The second part
    concerns the way from the TCP to the pose, and judges the component of this way that leads away from a
    true hand. The least component over all true hands is used. The margin is the lesser of the margins of
    both parts. If the margin is negative, the system could only stop.

    Every decision exercises the claim, and every true hand at a decision exercises the second part.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "fallback poses reachable and away"

    @reads(
        "joint_position_rad",
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        also=["decision.tick", "decision.time_s", "decision.opposite_position_in_base_m"],
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the fallback pose of every decision."""
        if len(trace.decisions) == 0:
            return unexercised(self, no_decision(trace))
        reachable = [
            Finding(
                reach_m(trace, decision, decision["opposite_position_in_base_m"]),
                float(decision["time_s"]),
                "",
            )
            for decision in trace.decisions
        ]
        away = [finding for decision in trace.decisions for finding in _away(trace, decision)]
        parts = (self._part(trace, "reachable", reachable), self._part(trace, "away from every hand", away))
        tried = [part for part in parts if part.exercised]  # each decision has a pose to be reached
        # A part without a finite margin is worse than a part that holds, but hides no part that is violated.
        worst = min(tried, key=lambda part: -math.ulp(0.0) if part.margin is None else part.margin)
        return replace(worst, sentence=self.sentence, exercised=len(trace.decisions), parts=parts)

    def _part(self, trace: Trace, title: str, findings: list[Finding]) -> Evaluation:
        if not findings:
            evaluation = inconclusive(self, f"{title}: never exercised, no true hand was there")
        else:
            worst, count = worst_of(findings), len(findings)
            reason = f"{title}{worst.what}: {f'worst of {count}' if count > 1 else 'one pose'}"
            evaluation = judged(self, trace, worst.margin_m, worst.time_s, reason, exercised=count)
        return replace(evaluation, sentence=f"fallback poses {title}")


def _away(trace: Trace, decision: np.void) -> list[Finding]:
    tick, findings = trace.ticks[decision["tick"]], []
    tcp_in_base = tick["transform_tcp_to_base"][:3, 3]
    position = decision["opposite_position_in_base_m"]
    for hand in np.flatnonzero(tick["hand_present"]):
        from_hand = tcp_in_base - tick["hand_position_in_base_m"][hand]
        distance = length(from_hand)
        margin_m = -trace.scenario.settings.avoidance.radius_m  # no pose leads away from nobody
        if is_somewhere(position):
            displacement = position - tcp_in_base
            margin_m = (
                float(product(displacement, from_hand)) / distance if distance > 0.0 else length(displacement)
            )
        name = trace.scenario.hands[hand].name
        findings.append(Finding(margin_m, float(decision["time_s"]), f" ({name})"))
    return findings


FALLBACK_POSES = CatalogueEntry(
    prop=FallbackPoses(),
    rationale="the arm falls back after an uncertain, faulty or late answer, so the fallback must be "
    "available at every decision",
    source="the paper, section 3.3; table 4 counts opposite poses out of reach",
    margin=(
        "the lesser of two lengths: the distance beyond the pose over which the straight path "
        "is reachable (at most 100 mm), and the least component of the path that leads away "
        "from a true hand"
    ),
    parameters="radius and least singular value in the settings",
    exercised="the controller made a decision",
    broken_by="a gate whose fallback leads towards the hand",
)


@dataclass(frozen=True, kw_only=True)
class StopsWhereNothingIsReachable:
    """The claim that the arm stops if it can reach neither the answer nor the opposite pose.

    The claim computes again from the true joints whether the arm can reach the answer and the opposite pose.
    A missing answer cannot be reached. After the decision, the TCP may move as far as in a protective stop.
    The margin is this allowed distance minus the distance that the TCP actually moves (``stopped_m``). So an
    arm that moves on violates the claim, whatever its controller reports.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "stops where neither answer nor opposite pose can be reached"

    @reads(
        "joint_position_rad",
        "transform_tcp_to_base",
        "tcp_speed_mps",
        also=[
            "mode",
            "track_valid",
            "predicted_hand_in_base_m",
            "decision.tick",
            "decision.time_s",
            "decision.hand_position_in_base_m",
            "decision.proposed_position_in_base_m",
        ],
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision at which the arm could reach no position."""
        findings: list[Finding] = []
        least_m, when_s = np.inf, 0.0
        for decision in trace.decisions:
            answers = (decision["proposed_position_in_base_m"], opposite_position(trace, decision))
            farthest_m = max(reach_m(trace, decision, position) for position in answers)
            if farthest_m >= -BEYOND_DOUBT_M:
                least_m, when_s = min((least_m, when_s), (farthest_m, float(decision["time_s"])))
                continue
            left_m = stopped_m(trace, int(decision["tick"]))
            findings.append(Finding(left_m, float(decision["time_s"]), "way left of a stop's"))
        if not findings:
            least = f"with {least_m * 1e3:.1f} mm to spare at {when_s:.3f} s, or more"
            no_occasion = (
                f"one of the two could always be reached, {least}; neither within reach exercises it"
            )
            if len(trace.decisions) == 0:
                no_occasion = f"{no_decision(trace)} if neither can be reached"
            return unexercised(self, no_occasion)
        worst = worst_of(findings)
        reason = worst.what + (f", worst of {len(findings)}" if len(findings) > 1 else "")
        return judged(self, trace, worst.margin_m, worst.time_s, reason, exercised=len(findings))


STOPS = CatalogueEntry(
    prop=StopsWhereNothingIsReachable(),
    rationale="an arm that continues as before does not react to the hand, and an arm that moves "
    "towards an unreachable position ends at its limits",
    source="the last of the three steps: answer, opposite pose, stop",
    margin=(
        "the distance that the TCP may travel until it stops, minus the distance that it "
        "travelled. The allowed distance is v T_r + v T_s/2, plus the distance of one control "
        "period, plus 2 mm"
    ),
    parameters="reaction time, stop time, radius and least singular value in the settings",
    exercised="a decision at which neither the answer nor the opposite pose can be reached",
    scenario="nothing-reachable",
    broken_by=(
        "an avoider that proposes a position two metres away, behind a gate that accepts every proposal"
    ),
)
