"""Find which assumptions of docs/explanation/shield.md failed in a run.

A trace shows directly whether the assumptions 1 to 5, 7 and 9 held. It shows the assumptions 6 and 8
indirectly. A wrong time stamp (assumption 6) puts a hand in a wrong place, which breaks assumption 5. Drives
that brake late or too weakly (assumption 8) do not follow the commands, which breaks assumption 7. A trace
cannot show whether a capsule encloses its link.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.cell.controller.stack import STANDSTILL_RADPS
from safety_harness.cell.robot.drive import delay_ticks
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.signals.true_motion import SAME_M, first_untruth
from safety_harness.scenario.shield import Shield
from safety_harness.trace.trace import Trace, once_a_trace

Floats = NDArray[np.float64]
RELATIVE, TURNED_RAD = 1e-6, 1e-4  # rounding; and 0.1 mm at 1 m
NOT_KNOWN = 10  # in place of an assumption's number
# Masks of a run's ``theorem_bits``, in which bit n says that assumption n did not hold.
SHIELDED, BROKEN, REFUTED = 1, 0b11111111110, 1 << 11


class BrokenAssumption(NamedTuple):
    """An assumption of the theorem, and the first tick at which it failed.

    If the trace does not record enough, ``number`` is NOT_KNOWN.
    """

    number: int
    tick: int
    text: str


@once_a_trace
def broken_assumptions(trace: Trace) -> list[BrokenAssumption]:
    """Return the first failure of each assumption, in the order of the assumptions.

    For old traces, the only entry is NOT_KNOWN. The run must have a shield.
    """
    shield = trace.scenario.shield
    assert shield is not None
    if "sent_radps" not in (trace.interventions.dtype.names or ()):
        return [BrokenAssumption(NOT_KNOWN, 0, "the trace does not say what the shield saw and sent")]
    broken = [*_of_hands(trace, shield), *_of_drives(trace, shield)]
    untruth = first_untruth(trace)
    if untruth is not None:
        broken.append(_broken(trace, 9, untruth.index, str(untruth)))
    return broken


def _broken(trace: Trace, n: int, tick: int, why: str) -> BrokenAssumption:
    return BrokenAssumption(n, tick, f"assumption {n} did not hold at {trace.time_s[tick]:.3f} s: {why}")


def counts_words(runs: Iterable[tuple[int, int]]) -> str:
    """Return a line on how often the theorem's assumptions held in ``runs``.

    The line is empty if no run has a shield. Each entry of ``runs`` is a pair: a value of ``theorem_bits``,
    and the number of runs with this value.
    """
    there = list(runs)

    def with_any(mask: int) -> int:
        return sum(count for bits, count in there if bits & mask)

    shielded = with_any(SHIELDED)
    if not shielded:
        return ""
    bit_texts = {1 << n: f", assumption {n} did not hold in" for n in range(1, NOT_KNOWN)}
    bit_texts |= {1 << NOT_KNOWN: ", not known of", REFUTED: "; THE THEOREM IS REFUTED in"}
    text = f"the assumptions that a trace tells held in {shielded - with_any(BROKEN):,} of {shielded:,} runs"
    return text + "".join(
        f"{bit_text} {with_any(bit):,}" for bit, bit_text in bit_texts.items() if with_any(bit)
    )


def _of_hands(trace: Trace, shield: Shield) -> list[BrokenAssumption]:
    """Return the first failure of each of the assumptions 1 to 5."""
    ticks, done, hands = trace.ticks, trace.interventions, trace.scenario.hands
    period_s, size = trace.scenario.settings.clock.control_period_s, trace.scenario.settings.hand
    there = ticks["hand_present"][:, : len(hands)]
    at_m = np.where(there[..., None], ticks["hand_position_in_base_m"][:, : len(hands)], np.nan)
    elbow_m = ticks["elbow_position_in_base_m"][:, : len(hands)]
    moved_mps = np.diff(at_m, axis=0) / period_s
    speed_mps = np.linalg.norm(moved_mps, axis=2)
    reach_m = np.maximum(size.radius_m, np.linalg.norm(elbow_m - at_m, axis=2) + size.forearm_radius_m)
    # each hand's place when the frame that the shield used was taken, and the nearest box
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
    broken = []
    for number, was, most, where, template in checks:
        exceeds = where & ~(was <= most * (1.0 + RELATIVE) + SAME_M)
        if exceeds.any():
            k, hand = (int(i) for i in np.argwhere(exceeds)[0])
            worst = float(was[k, hand])
            text = template.format(hand=hands[hand].name, was=worst, mm=worst * 1e3)
            broken.append(_broken(trace, number, k, text))
    return broken


def _of_drives(trace: Trace, shield: Shield) -> list[BrokenAssumption]:
    """Return the first failure of assumption 7.

    Assumption 7 requires that each joint velocity is a weighted mean of recent commands and zero. Recent
    commands are those within the last reaction time. In addition, a joint must not turn farther than its
    commands demand.
    """
    period_s = trace.scenario.settings.clock.control_period_s
    held = delay_ticks(shield.reaction_time_s, period_s)
    sent = trace.interventions["sent_radps"][:-1]
    turned = np.diff(trace.ticks["joint_position_rad"], axis=0)
    late = np.concatenate([np.zeros((held, sent.shape[1])), sent])  # row k: of so many ticks before tick k
    deviation_rad = np.abs(turned).max(axis=1)
    # One command explains most ticks. Only the others need the mean of several commands, which takes longer.
    for i in range(held + 1):
        deviation_rad = np.fmin(
            deviation_rad, np.abs(turned - late[i : i + len(sent)] * period_s).max(axis=1)
        )
    most = STANDSTILL_RADPS * period_s
    for k in np.flatnonzero(~(deviation_rad <= most)).tolist():
        if not _mean(late[k : k + held + 1] * period_s, turned[k]) <= most:
            return [_not_sent(trace, k, turned[k], held)]
    # Sums from any earlier tick to now: a joint may not turn farther than its commands in that time demand.
    path = np.concatenate([np.zeros((1, sent.shape[1])), np.abs(turned).cumsum(axis=0)])
    worth = np.abs(late * period_s).cumsum(axis=0)
    begun = np.concatenate([np.zeros((1, sent.shape[1])), worth])[: len(path)]
    spare = np.minimum.accumulate((path - begun)[:-1], axis=0)
    broken = ~(path[1:] - worth[held:] <= spare + TURNED_RAD)
    if broken.any():
        k = int(broken.any(axis=1).argmax())
        return [_not_sent(trace, k, turned[k], held)]
    return []


def _mean(sent: Floats, turned: Floats) -> float:
    """Return how far ``turned`` (joints,) is from the nearest mean of commands.

    A mean is any weighted mean of zero and the rows of ``sent`` (n, joints).
    """
    from scipy.optimize import nnls  # takes long to import, and few drives need it

    if not np.isfinite(turned).all():
        return np.inf
    scale = max(float(np.abs(sent).max()), 1e-12)
    # Non-negative weights with the sum 1, where the last column is the command 0. The scale gives all rows a
    # similar size.
    rows = np.vstack([sent.T / scale, np.ones(len(sent))])
    weights, _ = nnls(np.hstack([rows, np.eye(len(rows))[:, -1:]]), np.append(turned / scale, 1.0))
    return float(np.abs(product(weights[:-1], sent) - turned).max())


def _not_sent(trace: Trace, k: int, turned: Floats, held: int) -> BrokenAssumption:
    period_s, worst = trace.scenario.settings.clock.control_period_s, int(np.abs(turned).argmax())
    name = arm_model(trace.scenario.robot).joint_names[worst]
    delay = f"within {held * period_s * 1e3:.0f} ms" if held else "at once"
    text = f"{name} turned at {turned[worst] / period_s:.4g} rad/s, which is not what was sent, {delay}"
    return _broken(trace, 7, k, text)
