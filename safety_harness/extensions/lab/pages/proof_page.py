"""A self-contained HTML page about proofs.

It shows the proven parts of each claim, with maps of the rest, and separately the bounds from random samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from markupsafe import Markup

from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
from safety_harness.extensions.lab.pages.question_maps import Scale, class_map, key_of
from safety_harness.extensions.lab.proof.certificate import NO_PAIR, Proof, model_hash, outward
from safety_harness.extensions.lab.proof.maps import EDGES, BoxMap, maps_of
from safety_harness.extensions.lab.proof.plan import ProofPlan
from safety_harness.extensions.lab.proof.together import JointBound
from safety_harness.extensions.pages.page_parts import in_words, render_page
from safety_harness.report.words import point_words

SHARES = ("none of it", "under 1 %", "1 to 10 %", "10 to 50 %", "half or more")
SCALE = Scale(EDGES, SHARES, shares=True)
STATES = {"proven": "holds", "refuted": "violated", "undecided": "inconclusive", NO_PAIR: "inconclusive"}


@dataclass(frozen=True, kw_only=True, eq=False)
class ProofEvidence:
    """The content of the page.

    ``command`` is the command line that repeats the proofs.  ``files`` has an entry for each claim: the name
    of a scenario file whose run begins with the question that refutes the claim, or None.
    """

    plan: ProofPlan
    proofs: tuple[Proof, ...]
    bounds: tuple[JointBound, ...]
    files: tuple[str | None, ...]
    command: str
    generated_at: datetime
    interrupted: bool = False


def render(evidence: ProofEvidence) -> str:
    """Return the text of the page, which depends only on ``evidence``."""
    proofs = evidence.proofs
    proven = sum(proof.verdict == "proven" for proof in proofs)
    return render_page(
        "proof.html.j2",
        package="safety_harness.extensions.lab",
        basis=BASIS_OF_ANSWERS,
        style="score.css",
        e=evidence,
        answer=f"{evidence.plan.title}: {proven} of {len(proofs)} claims proven",
        generated=in_words(evidence.generated_at),
        sections=[_section(evidence, number) for number in range(len(proofs))],
        key=Markup(key_of(SCALE)),
        sha256=model_hash(evidence.plan),
        version=installed_version(),
        source=source_hash(),
    )


def drawn_maps(maps: tuple[BoxMap, ...], prefix: str) -> Iterator[tuple[str, Markup]]:
    """Yield the caption and the drawing of each map.

    The function omits the maps of refuted parts if no part is refuted.

    Args:
        maps: The maps.
        prefix: The prefix of the drawings' identifiers.

    """
    for number, box in enumerate(maps):
        classes = box.classes
        if box.what == "refuted" and not (classes > 0).any():
            continue
        caption = f"{box.what}, by the {box.who} {box.seen}"
        ends = ((box.low_m[0], box.high_m[0]), (box.low_m[1], box.high_m[1]))
        drawing = class_map(
            classes, SCALE, ends, box.axes, f"seen {box.seen}", prefix=f"{prefix}{number}-", title=caption
        )
        yield caption, Markup(drawing)


def _section(evidence: ProofEvidence, number: int) -> dict[str, object]:
    """Return the page's content for one claim."""
    proof, bound = evidence.proofs[number], None
    if evidence.bounds:
        bound = evidence.bounds[number]
    proven, refuted, undecided = outward(proof.least_shares)
    question = proof.question
    return {
        "id": f"claim-{number + 1}",
        "claim": proof.planned.claim.sentence,
        "region": proof.planned.region.name,
        "verdict": proof.verdict,
        "nothing": proof.verdict == NO_PAIR,
        "state": STATES[proof.verdict],
        "cells": (proven, refuted, undecided, f"{sum(map(len, proof.tree.levels)):,}"),
        "bound": bound,
        "hand": "" if question is None else point_words(np.array(question.hand_in_base_m)),
        "tcp": "" if question is None else point_words(np.array(question.tcp_in_base_m)),
        "file": evidence.files[number],
        "maps": () if not proof.is_open else tuple(drawn_maps(tuple(maps_of(proof)), f"m{number}-")),
    }
