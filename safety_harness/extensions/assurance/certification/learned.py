"""The learned part of the system, as a report describes it.

The report states the training, the distance of the strata from the training data, and the service.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from safety_harness.admission.avoiders import folder_of, is_a_program
from safety_harness.admission.driving import named_system
from safety_harness.base.exceptions import on_one_line
from safety_harness.base.shipped.contents import located
from safety_harness.cell.avoidance.model_file import onnx_bytes, onnx_metadata
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import LearnedPart, TrainingDistance
from safety_harness.extensions.assurance.certification.stored import Stored
from safety_harness.extensions.assurance.certification.system import model_of
from safety_harness.scenario.files import resolved
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import LEARNED, file_and_name, names_onnx
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
TRAINING = "training"  # a key in the metadata of an ONNX file
MOST_LETTERS = 2000
NOT_STATED = "not stated: on what, and how. The metadata of an ONNX file may say it under the name 'training'"
PROGRAM = (
    "not stated: a program may have a learned part in it, and its hash is not that of the weights which it "
    "loads. The plan may say under about: what was learned, and on what; a network that is given as an ONNX "
    "file is known by its hash, and its metadata may say it under the name 'training'"
)
POLICY = (
    "by PPO in the space reaching-hands, random seed 0, 1.5 million actions of 40 ms (the package's "
    "examples/train_a_policy.py). How far hands lie from those of its training is not measured"
)
_CELLS = (
    "SELECT c.words, count(*) FROM episode e JOIN cell c ON c.id = e.cell "
    "WHERE e.stratum = ? GROUP BY c.words"
)


def learned_of(plan: Plan, ledger: Ledger, stored: Sequence[Stored]) -> LearnedPart | None:
    """Return the learned part of a plan's system, or None if no part under test is learned.

    Any user's program may have a learned part. A shipped avoider without a network has no learned part.

    Args:
        plan: The plan.
        ledger: The open ledger of the plan's runs.
        stored: The stored random runs.

    """
    scenarios = [plan.with_avoider(stratum.space.simplest) for stratum in plan.strata]
    learned = {place: item for place, item in enumerate(scenarios) if _is_network(item)}
    facts = dict(pair for item in scenarios for pair in _training_facts(item))
    if not facts and not learned:
        return None
    networks = ((str(item.under_test), str(named_system(item).tested.sha256)) for item in learned.values())
    nets = {place: item for place, item in learned.items() if not item.driven}
    return LearnedPart(
        networks=tuple(dict.fromkeys(networks)),
        seen=tuple(dict.fromkeys(seen_of(item).source for item in nets.values())),
        strata=tuple(_distance(plan, ledger, stored, place, scenario) for place, scenario in nets.items()),
        life=(*facts.items(), *(LIFE if learned else ())),
    )


def _is_network(scenario: Scenario) -> bool:
    reference = scenario.under_test
    in_onnx = names_onnx(reference) or (scenario.driven and reference == LEARNED)
    return in_onnx or model_of(scenario) is not None


def _training_facts(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """If a part has no model card, yield a label and a text about the training of the part."""
    reference = scenario.under_test
    if is_a_program(reference):
        yield f"{reference}, whether learned", PROGRAM
    elif scenario.driven and reference == LEARNED:
        yield f"{reference}, trained", POLICY
    elif names_onnx(reference):
        own = os.path.expanduser(file_and_name(reference)[0])
        file = resolved(located((folder_of(scenario) or Path()) / own))
        text = onnx_metadata(file, onnx_bytes(file)).get(TRAINING, "").strip()
        yield f"{reference}, trained", on_one_line(text)[:MOST_LETTERS] if text else NOT_STATED


def _distance(
    plan: Plan, ledger: Ledger, stored: Sequence[Stored], place: int, scenario: Scenario
) -> TrainingDistance:
    counts: Counter[str] = Counter()
    for label, runs in ledger.all(_CELLS, place):
        parts = label.split(", ")
        if len(parts) == len(AXES):
            counts[parts[list(AXES).index("seen")]] += int(runs)
    decisions = [item.trace.decisions for item in stored if item.stratum == place]
    hands_m = np.concatenate([row["hand_position_in_base_m"] for row in decisions] or [np.empty((0, 3))])
    seen = seen_of(scenario).hand
    outside = ~seen.contains(hands_m)  # NaN counts as outside
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
