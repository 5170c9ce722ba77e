"""Write all results of a scoring session as JSON for other programs, in the file evaluation.json.

All values are in SI units, and the names of the fields include the units.
"""

from __future__ import annotations

import json
import math
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.cell.avoidance.asking import Question
from safety_harness.extensions.lab.pages.score_tables import is_green, most_towards
from safety_harness.extensions.lab.scoring.questions import Answers, Questions
from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider, ShownQuestion
from safety_harness.extensions.lab.scoring.scorecard import Scorecard
from safety_harness.report.words import count_words

SCHEMA = "safety-harness scores 1"
NAMES = {  # names of the figures in a scorecard's tuples
    "gained_m": ("p50", "p5"),
    "angle_rad": ("p50", "p95"),
    "off_m": ("p50", "p95", "p99"),
    "bias_in_base_m": ("x", "y", "z"),
    "within": ("one", "two", "three"),
}


def document(scored: Scored) -> str:
    """Return the text of the file.

    Only the field ``times`` depends on measured times.  All other fields are the same if the session is
    repeated.
    """
    whole = {
        "schema": SCHEMA,
        "package_version": installed_version(),
        "source_hash": source_hash(),
        "seed": scored.seed,
        "search_budget": scored.budget,
        "against": scored.against or None,
        "interrupted": scored.interrupted,
        "failed": scored.failed,
        "finding_count": scored.findings,
        "avoiders": [_of_avoider(avoider) for avoider in scored.avoiders],
        "times": {avoider.card.avoider: _plain(avoider.card.times) for avoider in scored.avoiders},
    }
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"


def sentence(scored: Scored) -> str:
    """Return a sentence that summarises the result of the session."""
    count = sum(len(region.questions) for entry in scored.avoiders for region in entry.card.regions)
    names = ", ".join(entry.card.avoider for entry in scored.avoiders)
    text = f"{count:,} questions" + f" beside {scored.against}" * bool(scored.against)
    if not scored.avoiders:
        return "Nothing was scored."
    often = [entry.card for entry in scored.avoiders if not is_green(entry.card)]
    if not scored.findings and often:
        share, region = max(map(most_towards, often), key=lambda entry: (entry[1] != "", entry[0]))
        towards = f"{100 * share:.3g} % of proposals lead towards the hand in {region}"
        if not region:
            towards = "no region got a proposal"
        return f"No finding beyond the yardsticks on {names} in {text}, but {towards}."
    if not scored.findings:
        return f"No finding on {names} in {text}: no figure is beyond its limit, which is no proof of safety."
    return f"{count_words(scored.findings, 'finding', 'findings')} on {names} in {text}."


def _of_avoider(scored: ScoredAvoider) -> dict[str, Any]:
    """Return the results of one avoider; the results of searches are separate from the score card."""
    return {
        "reference": scored.reference,
        "sha256": scored.sha256 or None,
        **_of_card(scored.card),
        "findings": _plain(scored.findings),
        "unlike_the_reference": _plain(scored.unlike),
        "yardsticks": [_of_card(card) for card in scored.yardsticks],
        "search": {
            "about": "a ledger of its own: a search chooses its questions, so these enter no figure above",
            "regions": [
                {
                    "region": search.region,
                    "budget": search.budget,
                    "asked": search.asked,
                    "unanswered": search.unanswered,
                    "interrupted": search.interrupted,
                }
                for search in scored.searches
            ],
            "worst": [_of_worst(shown) for shown in scored.worst],
            "left_out": scored.left_out,
        },
    }


def _of_card(card: Scorecard) -> dict[str, Any]:
    """Return a score card as data for JSON, without its times."""
    content: dict[str, Any] = _plain(card)
    content.pop("times")
    return content


def _of_worst(shown: ShownQuestion) -> dict[str, Any]:
    """Return a worst question and the claims in its scenario as data for JSON."""
    file = shown.file
    return {
        "objective": shown.objective.value,
        **_plain(shown.tried),
        "file": None if file.path is None else file.path.name,
        "claims": {claim.sentence: claim.expected.value for claim in file.claims},
    }


def _plain(value: Any, name: str = "") -> Any:
    """Return a value as data for JSON.

    NaN and infinity become null.  The result omits arrays of questions and answers.
    """
    if isinstance(value, Question):
        value = {key: part for key, part in value._asdict().items() if key != "limit_s"}
    if is_dataclass(value) and not isinstance(value, type):
        parts = {part_field.name: getattr(value, part_field.name) for part_field in fields(value)}
        kept = {key: part for key, part in parts.items() if not isinstance(part, Questions | Answers)}
        counts = {"asked": len(parts["questions"])} if isinstance(parts.get("questions"), Questions) else {}
        return counts | {key: _plain(part, key) for key, part in kept.items()}
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        parts_of = [_plain(part) for part in value]
        return dict(zip(NAMES[name], parts_of, strict=True)) if name in NAMES else parts_of
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.value if isinstance(value, Enum) else value
