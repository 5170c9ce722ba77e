"""Check that the arm really gives way: it must move away from every hand, as far and as fast as it can.

The progress of a repulsion is compared with that of a reference, a point mass. The reference begins with the
TCP's true position and velocity, heads for the chosen position, and slows down in time to stop there. The
reference uses nine tenths of the repulsion speed and seven tenths of the repulsion's acceleration. For this,
the speed is taken to be at least 20 mm/s and the acceleration at least 0.1 m/s^2, because a slower motion is
no retreat. While the drives brake or a joint is at its speed limit, the reference moves like the TCP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import length, product
from safety_harness.base.geometry.arrays import Array3
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.properties.base import Evaluation, Unit, is_somewhere, judged
from safety_harness.claims.properties.entry import CatalogueEntry, quantity
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import nearest_of, no_hand, no_position, no_time
from safety_harness.scenario.units import LENGTH
from safety_harness.trace.records import DecisionOutcome, Limit, Mode, Trigger
from safety_harness.trace.trace import Trace

LEAST_WAY_M = 0.010  # a shorter way is not giving way, and a reference with a shorter way is no evidence
ARRIVED_FRACTION = 0.1  # of the way may be left when the controller regards the arm as arrived
DIP_M = 1e-4  # by which the executed way may lead nearer than is unavoidable
# A choice, below the 99 % of the speed and 80 % of the acceleration with which the shipped controller plans
# (controller/motion), so that a correct retreat keeps up.
SPEED_SHARE, ACCELERATION_SHARE = 0.9, 0.7
# A choice: a slower motion is no retreat, whatever the settings say.
LEAST_SPEED_MPS, LEAST_ACCELERATION_MPS2 = 0.020, 0.1
SLACK_M = 0.002  # how far the TCP may stay behind the reference; one control period's way more, but
NOT_OFF = np.zeros(3)
SLACK_SHARE = 0.1  # at most this share of the whole way


class Shares(NamedTuple):
    """The fractions that determine the motion of the reference.

    The reference moves with these fractions of the speed and the acceleration of the repulsion. The fraction
    of the acceleration applies only while the reference speeds up.
    """

    speed: float
    acceleration: float


MODEST = Shares(SPEED_SHARE, ACCELERATION_SHARE)


@dataclass(frozen=True)
class Finding:
    """A margin [m], the time [s] at which it occurs, and a description of it."""

    margin_m: float
    time_s: float
    what: str


def worst_of(findings: Sequence[Finding]) -> Finding:
    """Return the first of ``findings`` whose margin is not finite, or else the finding with the least margin.

    ``findings`` must not be empty.
    """
    unknown = next((finding for finding in findings if not np.isfinite(finding.margin_m)), None)
    return unknown or min(findings, key=lambda finding: finding.margin_m)


@dataclass(frozen=True)
class _End:
    """The least and the largest possible margin [m] of a finding.

    Unless ``always`` is True, the finding is used only if its margin is negative.
    """

    low_m: float
    high_m: float
    always: bool = False


def _ends(prop: MovesAway, trace: Trace) -> tuple[float, float, bool]:
    """Return the bounds of the least margin over all decisions for ``reads``.

    Both bounds are infinite if a decision was caused by another hand and therefore continues an earlier
    repulsion.
    """
    if trace.known.uncertain(["demanded_joint_velocity_radps"]):
        return -np.inf, np.inf, False
    ends: list[_End] = []
    exercised = False
    for number, decision in enumerate(trace.decisions):
        if decision["outcome"] == DecisionOutcome.STOP:
            continue
        somewhere = is_somewhere(decision["chosen_position_in_base_m"])
        if decision["trigger"] == Trigger.ANOTHER_HAND or not somewhere:
            return -np.inf, np.inf, False
        bounds, done = _ends_of(prop, trace, number)
        ends += bounds
        exercised |= done
    sure = [end.high_m for end in ends if end.always or end.high_m < 0.0]
    return min((end.low_m for end in ends), default=-np.inf), min(sure, default=np.inf), exercised


def _ends_of(prop: MovesAway, trace: Trace, number: int) -> tuple[list[_End], bool]:
    """Return bounds of the margins of decision ``number``, and whether it certainly exercised the claim.

    The decision's tick is uncertain by one tick, or by the length of a gap. The errors of the TCP's position
    and velocity displace the start of the reference and change its speed.
    """
    decision, count, known = trace.decisions[number], len(trace.ticks), trace.known
    first, last = int(decision["tick"]), last_tick(trace, number)
    # The decision may have been at a neighbouring tick or, in a gap of the column, anywhere in the gap.
    gaps = ((gap.first, gap.after) for gap in known.column("decision").gaps)
    around = slice(*next((gap for gap in gaps if gap[0] <= first < gap[1]), (max(first - 1, 0), first + 2)))
    run, period_s = slice(first, last + 1), trace.scenario.settings.clock.control_period_s
    tcp_m, hands_m = trace.ticks["transform_tcp_to_base"][:, :3, 3], trace.ticks["hand_position_in_base_m"]
    columns = "transform_tcp_to_base", "hand_position_in_base_m"
    off_m, hand_off_m = (known.uncertainty_of(name, count) for name in columns)
    # The reference may start at any position of these ticks, with the error of a position.
    start_off_m = float(off_m[around].max() + np.linalg.norm(tcp_m[around] - tcp_m[first], axis=1).max())
    way_m, moved_m = decision["chosen_position_in_base_m"] - tcp_m[first], tcp_m[run] - tcp_m[first]
    length_m = length(way_m)
    velocities = np.array([velocity_at(trace, tick) for tick in range(*around.indices(count))])
    speeds_mps = trace.ticks["tcp_speed_mps"] + known.uncertainty_of("tcp_speed_mps", count)
    fastest_mps = float(np.nan_to_num(speeds_mps[around], nan=np.inf).max())
    # A velocity is the difference of two positions. It cannot be off by more than the largest speed allows.
    dv_mps = 2.0 * float(off_m[around].max()) / period_s
    dv_mps = float(np.fmin(dv_mps, fastest_mps + np.linalg.norm(velocities, axis=1).max()))
    ends = [_End(length_m - start_off_m - LEAST_WAY_M, length_m + start_off_m - LEAST_WAY_M)]
    avoidance, counted = trace.scenario.settings.avoidance, False
    braking_mps2 = max(avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2)
    for hand in np.flatnonzero(trace.ticks["hand_present"][first]).tolist():
        u_m = float(hand_off_m[around].max())
        u_m += float(np.linalg.norm(hands_m[around, hand] - hands_m[first, hand], axis=1).max())
        apart_m = tcp_m[first] - hands_m[first, hand]
        distance_m = length(apart_m)
        # Surely too far away to be judged; ``sure`` below means surely near enough.
        if distance_m - start_off_m - u_m >= prop.nearer_m:
            continue
        sure = distance_m + start_off_m + u_m < prop.nearer_m
        counted |= sure
        away = apart_m / max(distance_m, 1e-9)
        # Displacements x and y of the ends turn a direction by at most 2 (x + y)/d. Two unit vectors differ
        # by at most 2.
        turned = min(2.0, 2.0 * (start_off_m + u_m) / max(distance_m, 1e-9))
        planned_m, planned_off_m = (
            float(product(way_m, away)) + prop.tolerance_m,
            start_off_m + length_m * turned,
        )
        ends.append(_End(planned_m - planned_off_m, planned_m + planned_off_m if sure else np.inf, sure))
        towards = product(-velocities, away)
        towards = np.maximum(0.0, np.array([towards.min() - dv_mps, towards.max() + dv_mps]))
        unavoidable_m = towards * towards / (2.0 * braking_mps2) + 2.0 * towards * period_s
        unavoidable_m += DIP_M + prop.tolerance_m
        nearer_m = np.linalg.norm(tcp_m[run] - hands_m[first, hand], axis=1) - distance_m
        least_m = max(distance_m - u_m - start_off_m, 1e-9)
        nearer_off_m = off_m[run] + start_off_m
        nearer_off_m += u_m * np.minimum(2.0, 2.0 * np.linalg.norm(moved_m, axis=1) / least_m)
        # At the decision itself the TCP has not moved, so its distance is compared with itself.
        nearer_off_m[0] = 0.0
        low_m = float((nearer_m - nearer_off_m).min()) + float(unavoidable_m[0])
        high_m = float((nearer_m + nearer_off_m).min()) + float(unavoidable_m[1])
        ends.append(_End(low_m, high_m if sure else np.inf))
    done = _followed(trace, decision, last)
    period_m = SPEED_SHARE * max(avoidance.repulsion_speed_mps, LEAST_SPEED_MPS) * period_s
    follow = off_m[run] + _led_m(trace, decision, last, start_off_m + period_m, dv_mps)
    slack_off_m = SLACK_SHARE * start_off_m
    low_m = done.slack_m - slack_off_m - float((done.behind_m + follow).max())
    high_m = done.slack_m + slack_off_m - float((done.behind_m - follow).max())
    ends.append(_End(-np.inf, np.inf) if done.excused else _End(low_m, high_m if counted else np.inf))
    if arrival_claimed(trace, number, last):
        left_m = length(decision["chosen_position_in_base_m"] - tcp_m[last])
        left_off_m = float(off_m[last]) + ARRIVED_FRACTION * start_off_m
        margin_m = ARRIVED_FRACTION * length_m - left_m
        ends.append(_End(margin_m - left_off_m, margin_m + left_off_m if counted else np.inf))
    return ends, counted and done.due_m - float(follow[-1]) >= LEAST_WAY_M


def _led_m(trace: Trace, decision: np.void, last: int, off_m: float, dv_mps: float) -> NDArray[np.float64]:
    """Return 1.5 times the change of the TCP's lag if the reference starts differently, shape (n,).

    The start of the reference is displaced by ``off_m``, and its speed is changed by ``dv_mps``. The result
    is the largest change over six directions: forwards and backwards along the way, and four directions at
    right angles to it. It is zero at the first tick.
    """
    first = int(decision["tick"])
    way_m = decision["chosen_position_in_base_m"] - trace.ticks["transform_tcp_to_base"][first, :3, 3]
    axes = _axes(way_m)
    plain_m, most_m = _followed(trace, decision, last).behind_m, np.zeros(last + 1 - first)
    for axis in (*axes, *-axes):
        shifted = _followed(trace, decision, last, off_m * axis, dv_mps * axis)
        most_m = np.maximum(most_m, np.abs(shifted.behind_m - plain_m))
    most_m[0] = 0.0
    return np.asarray(1.5 * most_m)


def _axes(way_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return orthogonal unit vectors (3, 3); the first is parallel to the way.

    The vectors come from a Householder reflection.
    """
    mirror = way_m.copy()
    # With this sign the two numbers never cancel.
    mirror[0] += np.copysign(length(way_m), way_m[0])
    square = product(mirror, mirror)
    return np.eye(3) - 2.0 * np.outer(mirror, mirror) / (square if square > 0.0 else 1.0)


@dataclass(frozen=True, kw_only=True)
class MovesAway:
    """The claim that the arm really gives way, and that this never brings the TCP nearer to a hand.

    The planned way is straight, so it is judged only at its start: if it leads away from a hand there, it
    leads away everywhere. The margin is the least component of the way that leads away from a true hand. For
    the TCP t, the position p and the hand h, this component is the scalar product of p - t and (t - h)/|t -
    h|. A way shorter than 10 mm violates the claim, and the margin is minus the missing length.

    The executed way ends with the repulsion or at the next decision. It has three margins, which are used
    only if they are negative. (1) The TCP may come nearer to the hand's position at the decision only by the
    unavoidable distance v^2/(2 a) + 2 v dt. Here v is the TCP's speed towards the hand at the decision, and a
    is the repulsion's acceleration. (2) The TCP may lag behind the reference only by a small distance. (3) If
    the controller regards the TCP as arrived, at most a tenth of the way may remain.

    The planned way may lead towards a hand by at most ``tolerance_m``. In (1), the same tolerance applies to
    the executed way. Only hands that are nearer to the TCP than ``nearer_m`` at the decision are judged,
    because a hand that rests far away is no hazard.

    A decision exercises the claim if a true hand was present and the reference had time to move by 10 mm.
    Source: section 4.1 of the paper ("a quarter of a sphere will lead the robot to move away").
    """

    nearer_m: float = np.inf
    tolerance_m: float = 0.0
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """Return the sentence of the catalogue."""
        nearer = f" nearer than {self.nearer_m * 1e3:g} mm" if np.isfinite(self.nearer_m) else ""
        tolerance = f" to within {self.tolerance_m * 1e3:g} mm" if self.tolerance_m else ""
        return f"repulsion moves away from every hand{nearer}{tolerance}"

    @reads(
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        "demanded_joint_velocity_radps",
        also=[
            "mode",
            "limits",
            "decision.tick",
            "decision.time_s",
            "decision.trigger",
            "decision.chosen_position_in_base_m",
            "decision.outcome",
        ],
        ends=lambda prop, trace, _: _ends(prop, trace),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the planned and the executed way of each decision in ``trace``."""
        findings: list[Finding] = []
        made = exercised = 0
        longest_m, nearest_m = 0.0, np.full(len(trace.ticks), np.inf)
        interrupted: RepulsionProgress | None = None
        for number, decision in enumerate(trace.decisions):
            if decision["outcome"] == DecisionOutcome.STOP:
                continue
            made += 1
            tick = trace.ticks[decision["tick"]]
            apart_m = np.linalg.norm(
                tick["hand_position_in_base_m"] - tick["transform_tcp_to_base"][:3, 3], axis=1
            )
            nearest_m[decision["tick"]] = np.min(apart_m, where=tick["hand_present"], initial=np.inf)
            hands = np.flatnonzero(tick["hand_present"] & ~(apart_m >= self.nearer_m))
            if len(hands) == 0:
                continue  # nobody there to move away from
            if not is_somewhere(decision["chosen_position_in_base_m"]):
                findings.append(Finding(np.nan, float(decision["time_s"]), "no position"))
                continue
            last = last_tick(trace, number)
            goes_on = interrupted is not None and decision["trigger"] == Trigger.ANOTHER_HAND
            done = progress(trace, decision, last, interrupted if goes_on else None)
            exercised += done.due_m >= LEAST_WAY_M
            longest_m = max(longest_m, done.due_m)
            interrupted = done
            for hand in hands:
                findings.extend(away_from(trace, decision, int(hand), last, self.tolerance_m))
            findings.extend(given(trace, number, last, done))
        if not findings:
            far = nearest_of(trace, nearest_m, self.nearer_m, "hand at a decision") or no_hand(trace)
            return unexercised(self, far if made else no_position(trace))
        worst = worst_of(findings)
        reason = worst.what + (f", worst of {made}" if made > 1 else "")
        lacked = partial(no_time, longest_m, LEAST_WAY_M)
        return judged(self, trace, worst.margin_m, worst.time_s, reason, exercised, lacked)


def last_tick(trace: Trace, number: int) -> int:
    """Return the tick at which the repulsion of decision ``number`` has ended."""
    first = int(trace.decisions[number]["tick"])
    following = trace.decisions["tick"][number + 1 :]
    end = int(following[0]) if len(following) else len(trace.ticks) - 1
    moved_on = np.flatnonzero(trace.ticks["mode"][first : end + 1] != Mode.REPULSING)
    return first + int(moved_on[0]) if len(moved_on) else end


def away_from(
    trace: Trace, decision: np.void, hand: int, last: int, tolerance_m: float = 0.0
) -> list[Finding]:
    """Judge the planned and the executed way relative to the position of ``hand`` at the decision."""
    first, time_s = int(decision["tick"]), float(decision["time_s"])
    settings, name = trace.scenario.settings, trace.scenario.hands[hand].name
    hand_in_base = trace.ticks["hand_position_in_base_m"][first, hand]
    tcp_in_base = trace.ticks["transform_tcp_to_base"][first : last + 1, :3, 3]  # (n, 3)
    displacement = decision["chosen_position_in_base_m"] - tcp_in_base[0]
    from_hand = tcp_in_base[0] - hand_in_base
    distance = length(from_hand)
    if distance == 0.0:  # every way leads away from a hand that is at the TCP
        return [Finding(length(displacement), time_s, f"planned way, {name}")]
    away = from_hand / distance
    findings = [Finding(float(product(displacement, away)) + tolerance_m, time_s, f"planned way, {name}")]
    dt_s = settings.clock.control_period_s
    towards_mps = max(0.0, -float(product(velocity_at(trace, first), away)))
    braking_mps2 = max(settings.avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2)
    unavoidable_m = towards_mps * towards_mps / (2.0 * braking_mps2) + 2.0 * towards_mps * dt_s
    distances = np.linalg.norm(tcp_in_base - hand_in_base, axis=1)
    nearest = int(np.argmin(distances))
    nearer = Finding(
        float(distances[nearest]) - distance + unavoidable_m + DIP_M + tolerance_m,
        float(trace.time_s[first + nearest]),
        f"executed way, nearer to {name}",
    )
    return [*findings, nearer] if nearer.margin_m < 0.0 else findings


def given(trace: Trace, number: int, last: int, done: RepulsionProgress) -> list[Finding]:
    """Return findings on a way that is too short, is too slow or ends too early, whatever the hands do."""
    decision = trace.decisions[number]
    tcp_in_base = trace.ticks["transform_tcp_to_base"][:, :3, 3]
    target_in_base = decision["chosen_position_in_base_m"]
    length_m = length(target_in_base - tcp_in_base[int(decision["tick"])])
    findings = [Finding(length_m - LEAST_WAY_M, float(decision["time_s"]), "hardly any way at all")]
    findings.append(Finding(done.margin_m, float(trace.time_s[done.worst_tick]), "executed way, too slow"))
    if arrival_claimed(trace, number, last):
        left_m = length(target_in_base - tcp_in_base[last])
        margin_m = ARRIVED_FRACTION * length_m - left_m
        findings.append(Finding(margin_m, float(trace.time_s[last]), "executed way, ended too early"))
    return [finding for finding in findings if not finding.margin_m >= 0.0]


def arrival_claimed(trace: Trace, number: int, last: int) -> bool:
    """Return whether the controller ends the repulsion of decision ``number`` as if it had arrived.

    The controller does so if it returns to servoing, loses the object, or decides again for a reason other
    than another hand. It does not do so at a protective stop or at the end of the trace.
    """
    mode = trace.ticks["mode"][last]
    if mode == Mode.PROTECTIVE_STOP and last == trace.decisions["tick"][number]:
        return False  # too near to a singularity, at once
    following = number + 1
    if following < len(trace.decisions) and trace.decisions["tick"][following] == last:
        return bool(trace.decisions["trigger"][following] != Trigger.ANOTHER_HAND)
    return bool(mode in (Mode.SERVOING, Mode.OBJECT_LOST))


def velocity_at(trace: Trace, tick: int) -> NDArray[np.float64]:
    """Return the TCP's mean velocity [m/s] in the base frame over the period before ``tick``, shape (3,).

    The velocity is zero at tick 0.
    """
    if tick == 0:
        return np.zeros(3)
    positions = trace.ticks["transform_tcp_to_base"][tick - 1 : tick + 1, :3, 3]
    step: NDArray[np.float64] = positions[1] - positions[0]
    return step / trace.scenario.settings.clock.control_period_s


MOVES_AWAY = CatalogueEntry(
    prop=MovesAway(),
    pattern=r"repulsion moves away from every hand(?: nearer than (.+?))?(?: to within (.+))?",
    make=lambda match, _, place: MovesAway(
        nearer_m=quantity(match[1], LENGTH, place) if match[1] else np.inf,
        tolerance_m=quantity(match[2], LENGTH, place) if match[2] else 0.0,
    ),
    rationale="an avoider that moves the arm towards a hand, or not at all, makes the hazard worse",
    source="the paper, section 4.1",
    margin=(
        "the component of the planned displacement that leads away from a hand; the least "
        "value over all hands. The margin is also negative if the arm does not execute the "
        "plan"
    ),
    parameters=(
        '"... nearer than 600 mm" restricts the claim to hands that were so near to the TCP '
        'at the decision. "... to within 5 mm" states how much nearer to a hand the planned '
        "and the executed path may lead. Further parameters are the speed and the "
        "acceleration of a repulsion"
    ),
    exercised="a true hand was present, and the repulsion lasted long enough for a path of 10 mm",
    inconclusive="a chosen position that is not finite",
    broken_by="an avoider that moves towards the hand, behind a gate that accepts every proposal",
)


@dataclass(frozen=True)
class RepulsionProgress:
    """The progress of a repulsion in comparison with its reference.

    ``margin_m`` is the allowed lag behind the reference minus the TCP's largest lag. The largest lag occurs
    at ``worst_tick``. ``behind_m`` is the lag at the end, and ``due_m`` is the distance by which the
    reference approached the target.
    """

    margin_m: float
    worst_tick: int
    behind_m: float
    due_m: float


def progress(
    trace: Trace,
    decision: np.void,
    last: int,
    interrupted: RepulsionProgress | None,
    shares: Shares = MODEST,
) -> RepulsionProgress:
    """Return the progress from ``decision`` to the tick ``last``.

    The reference moves with the fractions ``shares``. ``interrupted`` is the progress of the repulsion that
    another hand interrupted before. The lag and the due distance of ``interrupted`` are added to those of
    this repulsion. Otherwise an arm could make new decisions again and again without moving.
    """
    first = int(decision["tick"])
    done = _followed(trace, decision, last, shares=shares)
    behind_m, due_m = done.behind_m, done.due_m
    if interrupted is not None:
        behind_m, due_m = behind_m + max(interrupted.behind_m, 0.0), due_m + interrupted.due_m
    worst = int(np.argmax(behind_m))  # the first NaN, if there is one
    return RepulsionProgress(done.slack_m - float(behind_m[worst]), first + worst, float(behind_m[-1]), due_m)


@dataclass(frozen=True, eq=False)
class _Followed:
    """A repulsion, with the distance ``behind_m`` (n,) by which the TCP lags behind the reference.

    ``excused`` is True if the reference moved like the TCP at any tick.
    """

    behind_m: NDArray[np.float64]
    due_m: float
    slack_m: float
    excused: bool


def _followed(
    trace: Trace,
    decision: np.void,
    last: int,
    off_m: NDArray[np.float64] = NOT_OFF,  # (3,)
    faster_mps: NDArray[np.float64] = NOT_OFF,  # (3,)
    shares: Shares = MODEST,
) -> _Followed:
    """Return the repulsion from ``decision`` to ``last``.

    The reference begins displaced by ``off_m`` and faster by ``faster_mps``.
    """
    first = int(decision["tick"])
    settings, avoidance = trace.scenario.settings, trace.scenario.settings.avoidance
    window = trace.ticks[first : last + 1]
    tcp_in_base = np.ascontiguousarray(window["transform_tcp_to_base"][:, :3, 3])
    earlier = trace.ticks["transform_tcp_to_base"][max(first - 1, 0), :3, 3]
    period_s = settings.clock.control_period_s
    velocity = (tcp_in_base[0] - earlier) / period_s + faster_mps
    tcp_in_base[0] += off_m
    excused = excused_in(trace, first, last)
    behind_m, due_m = _behind(
        tcp_in_base,
        velocity,
        decision["chosen_position_in_base_m"].copy(),
        excused,
        shares.speed * max(avoidance.repulsion_speed_mps, LEAST_SPEED_MPS),
        shares.acceleration * max(avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2),
        ACCELERATION_SHARE * max(avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2),
        period_s,
    )
    way_m = length(decision["chosen_position_in_base_m"] - tcp_in_base[0])
    slack_m = SLACK_M + min(period_s * avoidance.repulsion_speed_mps, SLACK_SHARE * way_m)
    return _Followed(behind_m, due_m, slack_m, bool(excused.any()))


def excused_in(trace: Trace, first: int, last: int) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which the drives brake or a joint is at its speed limit, shape (n,).

    The ticks are those from ``first`` to ``last``.
    """
    window, arm = trace.ticks[first : last + 1], arm_model(trace.scenario.robot)
    at_limit = np.abs(window["demanded_joint_velocity_radps"]) >= 0.999 * arm.velocity_limit_radps
    slowed = (window["limits"] & Limit.JOINT_SPEED != 0) & at_limit.any(axis=1)
    return np.asarray(slowed | (window["limits"] & Limit.BRAKING != 0))


@compiled
def _behind(
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    velocity_in_base_mps: NDArray[np.float64],  # (3,) at the first
    target_in_base_m: NDArray[np.float64],  # (3,)
    excused: NDArray[np.bool_],  # (n,)
    speed_mps: float,
    acceleration_mps2: float,
    braking_mps2: float,
    period_s: float,
) -> tuple[NDArray[np.float64], float]:
    """Return the TCP's lag [m] behind the reference at each tick, and a distance [m].

    The distance is how far the reference approached the target. At each tick, its velocity v becomes v +
    min(1, a dt/|u - v|) (u - v), and then its position x becomes x + v dt. The wanted velocity u points
    towards the target at the distance s, and has the speed min(v_max, (2 b s)^(1/2), s/dt). In an excused
    tick the reference moves like the TCP.
    """
    n = tcp_in_base_m.shape[0]
    behind = np.zeros(n)
    x, v, change = tcp_in_base_m[0].copy(), velocity_in_base_mps.copy(), np.empty(3)
    left_m = _distance(x, target_in_base_m)
    left = left_m
    for k in range(n):
        left = _distance(x, target_in_base_m)
        behind[k] = _distance(tcp_in_base_m[k], target_in_base_m) - left
        if k == n - 1:
            break
        # Brakes or a joint limit hold the arm back, which is no fault of the retreat.
        if excused[k]:
            for i in range(3):
                step = tcp_in_base_m[k + 1, i] - tcp_in_base_m[k, i]
                x[i] += step
                v[i] = step / period_s
            continue
        # The least of the top speed, the speed from which it can still stop at the target, and the speed that
        # reaches the target in one tick.
        speed = min(speed_mps, sqrt(2.0 * braking_mps2 * left), left / period_s)
        total = 0.0
        for i in range(3):
            wanted = speed * (target_in_base_m[i] - x[i]) / left if left > 0.0 else 0.0
            change[i] = wanted - v[i]
            total += change[i] * change[i]
        most = acceleration_mps2 * period_s
        share = most / sqrt(total) if total > most * most else 1.0
        for i in range(3):
            v[i] += share * change[i]
            x[i] += v[i] * period_s
    return behind, left_m - left


@compiled
def _distance(a: Array3, b: Array3) -> float:
    """Return |a - b| of two points ``a`` and ``b``."""
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
