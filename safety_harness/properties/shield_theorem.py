"""Which assumptions of docs/shield.md did not hold in a run, as far as its trace tells: 1 to 5, 7 and 9.

A time stamp that is wrong (6) puts a hand where it was not (5), and drives that brake late or less than they
are told (8) do not do what they are told (7).  A trace does not tell whether a capsule encloses its link.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.stack import STANDSTILL_RADPS
from safety_harness.properties.base import Evaluation
from safety_harness.properties.true_motion import SAME_M, first_untruth
from safety_harness.robot.drive import delay_ticks
from safety_harness.robot.robots import arm_model
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.shield import Shield
from safety_harness.trace.trace import Trace, once_a_trace

Floats = NDArray[np.float64]
BROKEN = "assumption {} did not hold at {:.3f} s: {}"
NOT_RECORDED = "the trace does not say what the shield saw and sent"
RELATIVE, TURNED_RAD = 1e-6, 1e-4  # rounding; and 0.1 mm at 1 m


def with_assumptions(trace: Trace, said: Evaluation) -> Evaluation:
    """The word on touches in a run, with what it says of the theorem of the shield, if there is one."""
    if trace.scenario.shield is None or len(trace.ticks) == 0:
        return said
    broken = broken_assumptions(trace)
    if broken:
        return replace(said, reason=f"{said.reason}; {broken[0]}")
    if said.verdict is not Verdict.VIOLATED:
        return said
    return replace(said, reason=f"{said.reason}; no assumption of the shield that a trace tells was broken")


@once_a_trace
def broken_assumptions(trace: Trace) -> list[str]:
    """What did not hold of each, at first, in the order of their numbers; NOT_RECORDED alone in old traces.

    Of a run with a shield.
    """
    shield = trace.scenario.shield
    assert shield is not None
    if "sent_radps" not in (trace.interventions.dtype.names or ()):
        return [NOT_RECORDED]
    found = [*_of_hands(trace, shield), *_of_drives(trace, shield)]
    wrong = first_untruth(trace)
    if wrong is not None:
        found.append(f"assumption 9 did not hold: {wrong}")
    return found


def _of_hands(trace: Trace, shield: Shield) -> list[str]:
    """Assumptions 1 to 5."""
    ticks, done, hands = trace.ticks, trace.interventions, trace.scenario.hands
    period_s, size = trace.scenario.settings.clock.control_period_s, trace.scenario.settings.hand
    there = ticks["hand_present"][:, : len(hands)]
    at_m = np.where(there[..., None], ticks["hand_position_in_base_m"][:, : len(hands)], np.nan)
    elbow_m = ticks["elbow_position_in_base_m"][:, : len(hands)]
    moved_mps = np.diff(at_m, axis=0) / period_s
    speed_mps = np.linalg.norm(moved_mps, axis=2)
    reach_m = np.maximum(size.radius_m, np.linalg.norm(elbow_m - at_m, axis=2) + size.forearm_radius_m)
    # where each hand was when the frame that the shield went by was taken, and the box nearest to that
    frame = np.clip(np.rint(np.maximum(done["taken_s"], 0.0) / period_s).astype(int), 0, len(ticks) - 1)
    real = np.arange(done["hand_in_base_m"].shape[1]) < done["count"][:, None]
    away_m = np.linalg.norm(done["hand_in_base_m"][:, None] - at_m[frame][:, :, None], axis=3)
    off_m = np.where(real[:, None], away_m, np.inf).min(axis=2)
    seen = done["taken_s"] > -np.inf
    few = seen & ((done["count"] < there.sum(axis=1)) | (there & ~there[frame]).any(axis=1))
    placed = there & (seen & ~few)[:, None]
    most_mps2 = np.inf if shield.hand_acceleration_mps2 is None else shield.hand_acceleration_mps2
    change_mps2 = np.linalg.norm(np.diff(moved_mps, axis=0), axis=2) / period_s
    checks = (  # number, what was (n, hands), at most, where it counts, words
        (1, speed_mps, shield.hand_speed_mps, there[1:] & there[:-1], "{hand} moved at {was:.3g} m/s"),
        (
            2,
            change_mps2,
            most_mps2,
            there[2:] & there[1:-1] & there[:-2],
            "{hand} changed its velocity by {was:.3g} m/s2",
        ),
        (3, reach_m, shield.body_m, there, "{hand}'s body reached {mm:.1f} mm from its centre"),
        (4, few[:, None] * 1.0, 0.0, few[:, None], "a hand was in no frame that the shield went by"),
        (5, off_m, shield.uncertainty_m, placed, "{hand} was {mm:.1f} mm from where the frame has it"),
    )
    found = []
    for number, was, most, where, words in checks:
        wrong = where & ~(was <= most * (1.0 + RELATIVE) + SAME_M)
        if wrong.any():
            k, hand = (int(i) for i in np.argwhere(wrong)[0])
            worst = float(was[k, hand])
            text = words.format(hand=hands[hand].name, was=worst, mm=worst * 1e3)
            found.append(BROKEN.format(number, trace.time_s[k], text))
    return found


def _of_drives(trace: Trace, shield: Shield) -> list[str]:
    """Assumption 7: the joints' velocity is a mean of what was sent in the last reaction time, or less.

    And no command turns a joint farther than it says.
    """
    period_s = trace.scenario.settings.clock.control_period_s
    held = delay_ticks(shield.reaction_time_s, period_s)
    sent = trace.interventions["sent_radps"][:-1]
    turned = np.diff(trace.ticks["joint_position_rad"], axis=0)
    late = np.concatenate([np.zeros((held, sent.shape[1])), sent])  # row k: of so many ticks before tick k
    off = np.abs(turned).max(axis=1)
    for i in range(held + 1):
        off = np.fmin(off, np.abs(turned - late[i : i + len(sent)] * period_s).max(axis=1))
    most = STANDSTILL_RADPS * period_s
    for k in np.flatnonzero(~(off <= most)).tolist():
        if not _mean(late[k : k + held + 1] * period_s, turned[k]) <= most:
            return [_not_sent(trace, k, turned[k], held)]
    path = np.concatenate([np.zeros((1, sent.shape[1])), np.abs(turned).cumsum(axis=0)])
    worth = np.abs(late * period_s).cumsum(axis=0)
    begun = np.concatenate([np.zeros((1, sent.shape[1])), worth])[: len(path)]
    spare = np.minimum.accumulate((path - begun)[:-1], axis=0)
    wrong = ~(path[1:] - worth[held:] <= spare + TURNED_RAD)
    if wrong.any():
        k = int(wrong.any(axis=1).argmax())
        return [_not_sent(trace, k, turned[k], held)]
    return []


def _mean(sent: Floats, turned: Floats) -> float:
    """How far ``turned`` (joints,) is from every mean of the rows of ``sent`` (n, joints) and zero."""
    from scipy.optimize import nnls  # takes long to import, and few drives need it

    if not np.isfinite(turned).all():
        return np.inf
    scale = max(float(np.abs(sent).max()), 1e-12)
    rows = np.vstack([sent.T / scale, np.ones(len(sent))])
    weights, _ = nnls(np.hstack([rows, np.eye(len(rows))[:, -1:]]), np.append(turned / scale, 1.0))
    return float(np.abs(weights[:-1] @ sent - turned).max())


def _not_sent(trace: Trace, k: int, turned: Floats, held: int) -> str:
    period_s, worst = trace.scenario.settings.clock.control_period_s, int(np.abs(turned).argmax())
    name = arm_model(trace.scenario.robot).joint_names[worst]
    within = f"within {held * period_s * 1e3:.0f} ms" if held else "at once"
    text = f"{name} turned at {turned[worst] / period_s:.4g} rad/s, which is not what was sent, {within}"
    return BROKEN.format(7, trace.time_s[k], text)
