"""What a report says of the learned part: how far the strata lie from its training, its life in service."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from safety_harness.admission.avoiders import avoider_sha256
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.certification.evidence import LearnedPart, TrainingDistance
from safety_harness.certification.stored import Stored
from safety_harness.certification.system import model_of
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import ONNX_SUFFIX
from safety_harness.search.counterexample import seen_of
from safety_harness.search.coverage import AXES, SEEN

LIFE = (
    (
        "Weights",
        "frozen: nothing here trains a network while it runs, and it is known by the hash of its file",
    ),
    (
        "With an unknown hash",
        "a campaign does not go on, certify refuses a plan that was declared with another network and a "
        "proof of another one, measured decision times of another are refused, and verify names the change. "
        "A new network takes a new report; certify --since says what got worse. Nothing here keeps a cell "
        "from loading another file: that is its controller's to check, against this hash",
    ),
    (
        "Recorded in service",
        "where the controller tells it: of each decision the hand and TCP that it was asked about, the "
        "proposal with its spread and threshold, what was chosen and why; beside joints, mode and hands",
    ),
    (
        "Back as evidence",
        "monitor judges a running cell by the same claims, judge its log; compare-worlds holds the "
        "simulators against the log, which certify --cell takes in. No run of a cell enters a bound here",
    ),
)
_CELLS = (
    "SELECT c.words, count(*) FROM episode e JOIN cell c ON c.id = e.cell "
    "WHERE e.stratum = ? GROUP BY c.words"
)


def learned_of(plan: Plan, ledger: Ledger, stored: Sequence[Stored]) -> LearnedPart | None:
    """None where no stratum's avoider is a network."""
    scenarios = [plan.with_avoider(stratum.space.simplest) for stratum in plan.strata]
    learned = {place: one for place, one in enumerate(scenarios) if _is_network(one)}
    if not learned:
        return None
    networks = ((one.avoider, avoider_sha256(one)) for one in learned.values())
    return LearnedPart(
        networks=tuple(dict.fromkeys(networks)),
        seen=tuple(dict.fromkeys(seen_of(one).source for one in learned.values())),
        strata=tuple(_distance(plan, ledger, stored, place, scenario) for place, scenario in learned.items()),
        life=LIFE,
    )


def _is_network(scenario: Scenario) -> bool:
    return model_of(scenario) is not None or scenario.avoider.endswith(ONNX_SUFFIX)


def _distance(
    plan: Plan, ledger: Ledger, stored: Sequence[Stored], place: int, scenario: Scenario
) -> TrainingDistance:
    counts: Counter[str] = Counter()
    for words, runs in ledger.all(_CELLS, place):
        parts = words.split(", ")
        if len(parts) == len(AXES):
            counts[parts[list(AXES).index("seen")]] += int(runs)
    decisions = [one.trace.decisions for one in stored if one.stratum == place]
    hands_m = np.concatenate([found["hand_position_in_base_m"] for found in decisions] or [np.empty((0, 3))])
    seen = seen_of(scenario).hand
    outside = ~seen.contains(hands_m)  # a hand that is no number is not inside
    far_m = seen.outside_m(hands_m[outside])
    far_m = far_m[np.isfinite(far_m)]
    return TrainingDistance(
        stratum=plan.strata[place].name,
        runs=tuple(counts[name] for name in SEEN),
        decisions=len(hands_m),
        share_outside=float(outside.mean()) if len(hands_m) else None,
        median_outside_m=float(np.median(far_m)) if len(far_m) else None,
        largest_outside_m=float(far_m.max()) if len(far_m) else None,
    )
