"""Check that a gate accepts answers only to queries in the region of a certificate.

The check covers the strata whose avoider uses the network of the certificate. The boxes that a gate declares
under the key ``questions within`` are compared exactly.
"""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from safety_harness.base.elementary import length
from safety_harness.cell.avoidance.shipped import network_file_of
from safety_harness.extensions.assurance.campaign.plan import Plan, Stratum
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.scenario.gate import AskedRegion

AXES = tuple(f"{who} {axis}" for who in ("hand", "TCP") for axis in "xyz")


def gate_words(plan: Plan, network_sha256: str, region: ProofRegion) -> tuple[str, ...]:
    """Return a line for each group of strata that have the same result.

    A stratum whose avoider uses another network is in no group.

    Args:
        plan: The plan with the strata.
        network_sha256: The hash of the file of the certificate's network.
        region: The region of the certificate.

    """
    groups: dict[str, list[str]] = {}
    for stratum in plan.strata:
        file = network_file_of(plan.with_avoider(stratum.space.simplest))
        if file is not None and sha256(file.read_bytes()).hexdigest() == network_sha256:
            groups.setdefault(_of_stratum(stratum, region), []).append(stratum.name)
    return tuple(f"{', '.join(names)}: {text}" for text, names in groups.items())


def _of_stratum(stratum: Stratum, region: ProofRegion) -> str:
    """Return a text with the result of the check for the gate of ``stratum``."""
    gate = stratum.space.simplest.gate
    if any(parameter.name.startswith("gate") for parameter in stratum.space.parameters):
        return "the gate varies from run to run, and was not compared with this region."
    if gate is None or gate.questions_within is None:
        return "no gate keeps to a region, so that the arm may act on answers of which this proves nothing."
    outside = outside_words(gate.questions_within, region)
    if outside:
        return f"the gate takes answers of which this proves nothing: to {outside}."
    return "the gate takes answers to questions of this region alone."


def outside_words(allowed: AskedRegion, region: ProofRegion) -> str:
    """Describe the queries in a gate's region ``allowed`` that lie outside the proof's ``region``.

    The text is empty if there are no such queries. The function compares the boxes first, then the distances
    from hand to TCP.
    """
    low = np.array([*allowed.hand.low_m, *allowed.tcp.low_m])
    high = np.array([*allowed.hand.high_m, *allowed.tcp.high_m])
    (least,), (most,) = region.corners()
    beyond_m = np.maximum(least - low, high - most)
    if beyond_m.max() > 0.0:
        parts = (f"{name} by {1e3 * x:.4g} mm" for name, x in zip(AXES, beyond_m, strict=True) if x > 0.0)
        return f"questions beyond its boxes ({', '.join(parts)})"
    gap_m = np.maximum(0.0, np.maximum(low[3:] - high[:3], low[:3] - high[3:]))
    wide_m = np.maximum(high[3:] - low[:3], high[:3] - low[3:])
    nearest_m, farthest_m = float(length(gap_m)), float(length(wide_m))
    near_m, far_m = region.apart_m
    if nearest_m >= near_m and farthest_m <= far_m:
        return ""
    distances, counted = (
        f"{1e3 * a:.4g} to {1e3 * b:.4g}" for a, b in ((nearest_m, farthest_m), (near_m, far_m))
    )
    return f"hands {distances} mm from the TCP, where this is about {counted} mm"
