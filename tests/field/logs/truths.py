"""What was true in a synthetic cell, beside what its log says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cells import FASTEST_MPS, Cell, Floats, Streams, cell, recorded, said, write_csv

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.signals.true_motion import derived
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Claim, RecordedHand, RecordedMotion, Verdict
from safety_harness.trace.known import WHOLLY_KNOWN
from safety_harness.trace.trace import Trace

FINE_S = 1e-3
FINE_M = 0.002  # by which the distance changes in half of that at most: the arm at 3 m/s, the hand at 1 m/s
SEPARATION = "protective separation kept from hands at their own speeds"
SEPARATION_EVERY = 4  # logs, as it is slow to judge
CLOCK_S, SENSOR_M, LONGEST_GAP_S = 0.005, 0.008, 0.2  # as cells.SAID says


@dataclass(frozen=True)
class Judged:
    """One claim of one log: what came out, and the true margin [m] (of the separation only its sign)."""

    sentence: str
    found: Evaluation
    true_m: float
    uncertainty_m: float  # as stated, infinite where a gap is longer than is said

    @property
    def false(self) -> bool:
        """Is it a verdict, and wrong?  The margin counts too: the true one is at least as clear."""
        if self.found.verdict is Verdict.HOLDS:
            return self.true_m < 0.0
        return self.found.verdict is Verdict.VIOLATED and self.true_m > FINE_M

    @property
    def clear(self) -> bool:
        """Is the true margin more than twice the stated uncertainty?"""
        return abs(self.true_m) > 2.0 * self.uncertainty_m

    @property
    def decided(self) -> bool:
        """Is there a verdict?"""
        return self.found.verdict is not Verdict.INCONCLUSIVE


def truth_at(trace: Trace, cell: Cell, time_s: Floats) -> Trace:
    """The trace of a log with what was true at ``time_s`` in place of what was recorded."""
    ticks = np.zeros(len(time_s), trace.ticks.dtype)
    ticks["time_s"], ticks["hand_present"][:, 0], ticks["decision"] = time_s, True, -1
    ticks["joint_position_rad"], ticks["joint_velocity_radps"] = (
        cell.joints_rad(time_s),
        cell.rates_radps(time_s),
    )
    ticks["hand_position_in_base_m"][:, 0], ticks["elbow_position_in_base_m"][:, 0] = (
        cell.hand_m(time_s),
        cell.elbow_m(time_s),
    )
    found = derived(replace(trace, ticks=ticks.copy(), known=WHOLLY_KNOWN))
    for name in ("transform_tcp_to_base", "tcp_speed_mps", "hand_distance_m", "hand_distance_capsule"):
        ticks[name] = found[name]
    (hand,) = trace.scenario.hands
    assert isinstance(hand, RecordedHand)
    moved = ticks["hand_position_in_base_m"][:, 0].copy(), ticks["elbow_position_in_base_m"][:, 0].copy()
    motion = RecordedMotion(time_s - time_s[0], *moved, (), hand.motion.sha256)
    scenario = replace(trace.scenario, hands=(replace(hand, motion=motion),))
    return replace(trace, scenario=scenario, ticks=ticks, known=WHOLLY_KNOWN)


def stated_m(streams: Streams) -> float:
    """Greatest speed x (clock error + longest time to the nearest sample) + sensor error."""
    longest_s = float(np.diff(streams.hand_ns).max()) / 1e9
    if longest_s > LONGEST_GAP_S:
        return np.inf
    return FASTEST_MPS * (CLOCK_S + longest_s / 2.0) + SENSOR_M


def judged_logs(seed: int, folder: Path) -> list[Judged]:
    """One synthetic log, as files, judged by claims with any threshold within 150 mm of the truth."""
    rng = np.random.default_rng(seed)
    one = cell(rng)
    lost = ()
    if rng.random() < 0.4:
        begin = float(rng.uniform(0.2, 1.2))
        lost = ((begin, begin + float(rng.uniform(0.05, 0.3))),)
    streams = recorded(one, rng, seconds=1.6, lost=lost)
    write_csv(streams, folder)
    text = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")
    (folder / "LOG.yaml").write_text(text)
    trace = trace_from_log(read_log(folder / "LOG.yaml")).trace
    end_s = float(trace.time_s[-1])
    true = truth_at(trace, one, np.arange(0.0, end_s + FINE_S / 2.0, FINE_S))
    nearest_m = float(true.ticks["hand_distance_m"][:, 0].min())
    found, within_m = [], stated_m(streams)
    for form in ("hand distance never below {:.6f} mm", "always hand distance > {:.6f} mm"):
        least_m = max(nearest_m + float(rng.uniform(-0.15, 0.15)), 0.001)
        sentence = form.format(least_m * 1e3)
        claim = Claim(sentence=sentence, expected=Verdict.HOLDS, place=trace.scenario.claims[0].place)
        evaluation = property_of(claim, trace.scenario).evaluate(trace)
        found.append(Judged(sentence, evaluation, nearest_m - least_m, within_m))
    if seed % SEPARATION_EVERY:
        return found
    exact = truth_at(trace, one, trace.time_s)
    claim = next(c for c in trace.scenario.claims if c.sentence == SEPARATION)
    prop = property_of(claim, trace.scenario)
    margin = prop.evaluate(exact).margin
    if margin is not None:
        found.append(Judged(SEPARATION, prop.evaluate(trace), float(margin), np.inf))
    return found
