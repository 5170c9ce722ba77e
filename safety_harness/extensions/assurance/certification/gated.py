"""Does each question whose answer a gate takes lie in the region that a certificate is about?

Of the strata that ask its network, by the boxes of ``gate: {questions within: ...}``, compared as they are.
"""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from safety_harness.cell.avoidance.shipped import network_file_of
from safety_harness.extensions.assurance.campaign.plan import Plan, Stratum
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.scenario.gate import AskedRegion

AXES = tuple(f"{who} {axis}" for who in ("hand", "TCP") for axis in "xyz")


def gate_words(plan: Plan, network_sha256: str, region: ProofRegion) -> tuple[str, ...]:
    """A line for all strata of which the same is to be said; none of a stratum that asks another network."""
    said: dict[str, list[str]] = {}
    for stratum in plan.strata:
        file = network_file_of(plan.with_avoider(stratum.space.simplest))
        if file is not None and sha256(file.read_bytes()).hexdigest() == network_sha256:
            said.setdefault(_of_stratum(stratum, region), []).append(stratum.name)
    return tuple(f"{', '.join(names)}: {words}" for words, names in said.items())


def _of_stratum(stratum: Stratum, region: ProofRegion) -> str:
    gate = stratum.space.simplest.gate
    if any(one.name.startswith("gate") for one in stratum.space.parameters):
        return "the gate varies from run to run, and was not compared with this region."
    if gate is None or gate.questions_within is None:
        return "no gate keeps to a region, so that the arm may act on answers of which this proves nothing."
    outside = outside_words(gate.questions_within, region)
    if outside:
        return f"the gate takes answers of which this proves nothing: to {outside}."
    return "the gate takes answers to questions of this region alone."


def outside_words(asked: AskedRegion, region: ProofRegion) -> str:
    """Which questions of a gate's region a proof's does not have; empty if it has them all."""
    low = np.array([*asked.hand.low_m, *asked.tcp.low_m])
    high = np.array([*asked.hand.high_m, *asked.tcp.high_m])
    (least,), (most,) = region.corners()
    beyond_m = np.maximum(least - low, high - most)
    if beyond_m.max() > 0.0:
        parts = (f"{name} by {1e3 * x:.4g} mm" for name, x in zip(AXES, beyond_m, strict=True) if x > 0.0)
        return f"questions beyond its boxes ({', '.join(parts)})"
    gap_m = np.maximum(0.0, np.maximum(low[3:] - high[:3], low[:3] - high[3:]))
    wide_m = np.maximum(high[3:] - low[:3], high[:3] - low[3:])
    nearest_m, farthest_m = float(np.linalg.norm(gap_m)), float(np.linalg.norm(wide_m))
    near_m, far_m = region.apart_m
    if nearest_m >= near_m and farthest_m <= far_m:
        return ""
    apart, counted = (
        f"{1e3 * a:.4g} to {1e3 * b:.4g}" for a, b in ((nearest_m, farthest_m), (near_m, far_m))
    )
    return f"hands {apart} mm from the TCP, where this is about {counted} mm"
