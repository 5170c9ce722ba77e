"""What a safety engineer asks: does giving way lead away from the hand, and does the whole keep 50 mm?"""

from __future__ import annotations

from typing import Any

import numpy as np

from safety_harness.base.settings import DEFAULTS
from safety_harness.claims.signals.separation import REACHING_MPS
from safety_harness_paper.avoiders import BAYESIAN, OPPOSITE
from safety_harness_paper.intervals import Estimate, Paired, mean_of, share_of
from safety_harness_paper.measurements import in_seeds, systems
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import (
    ClaimState,
    PaperClaim,
    PaperVerdict,
    Result,
    Table,
    estimate_words,
    every,
    fewer,
    number,
)
from safety_harness_paper.safety import (
    DISTANCE,
    OWN_SPEEDS,
    SEPARATION,
    SYSTEMS,
    leading_away,
    whole_behaviour,
)
from safety_harness_paper.scale import Scale
from safety_harness_paper.work import Task

MOVING_MPS = 0.010
SAYS = (
    "The repulsive pose based on the Bayesian DNN ensures safety by moving in the opposite direction of the "
    "obstacle."
)


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """Ways for each training seed, episodes for the first."""
    ways = {
        f"ways {k}": leading_away(
            systems(scale, root, k), pairs=scale.pairs, root=root, k=k, settings=DEFAULTS
        )
        for k in range(scale.seeds)
    }
    episodes = {
        f"episodes {number}": whole_behaviour(
            systems(scale, root, 0)[:2], episodes=scale.episodes, root=root, system=number, settings=DEFAULTS
        )
        for number in range(len(SYSTEMS))
    }
    return ways | episodes


def result(scale: Scale, found: Found) -> Result:
    """Numbers in answer; nothing that was not exercised counts for either side."""
    ways = in_seeds(found, "ways")
    episodes = in_seeds(found, "episodes")
    total = {
        key: sum(one[BAYESIAN]["near"][key] for one in ways)
        for key in ("pairs", "farther", "farther_all_along")
    }
    claims: list[PaperClaim] = []
    if total["pairs"]:
        claims += [
            every(
                "the Bayesian DNN's pose is farther from a hand within the critical distance than the TCP "
                "was",
                total["farther"],
                total["pairs"],
            ),
            every(
                "and the way there leads away from it all along", total["farther_all_along"], total["pairs"]
            ),
        ]
    for (name, _, _), found_one in zip(SYSTEMS[:2], episodes[:2], strict=True):
        for claim in (DISTANCE, SEPARATION, OWN_SPEEDS):
            one = _kept(found_one["episodes"], claim)
            exercised = one["holds"] + one["violated"]
            if exercised:
                claims.append(every(f"{name}: {claim}", one["holds"], exercised))
            else:
                claims.append(PaperClaim(f"{name}: {claim}", ClaimState.UNDECIDED, "exercised in no episode"))
    without = episodes[-1]["episodes"]
    for claim in (DISTANCE, OWN_SPEEDS):
        pairs = Paired.of(_violated(episodes[0]["episodes"], claim), _violated(without, claim))
        sentence = f"{SYSTEMS[0][0]}: {claim} in more episodes than without avoidance"
        claims.append(fewer(sentence, "giving way", "no avoidance", pairs))
    broken = sum(claim.state is ClaimState.CONTRADICTED for claim in claims)
    undecided = sum(claim.state is ClaimState.UNDECIDED for claim in claims)
    answer = "Not always" if broken else "Not shown" if undecided else "In all that was tried"
    why = f"{answer}: {broken} of {len(claims)} claims are contradicted, {undecided} undecided"
    return Result(
        name="safety",
        title="Does giving way keep the arm clear of the hand?",
        source="Section 1, safety",
        paper_says=SAYS,
        word=PaperVerdict.NO_VERDICT,
        why=f"{why}. They are ours; the paper has no figure.",
        claims=tuple(claims),
        tables=(
            _ways(ways, "near"),
            _ways(ways, "all"),
            *(_episodes(episodes, claim) for claim in (DISTANCE, SEPARATION, OWN_SPEEDS)),
            _decisions(episodes),
        ),
        notes=(
            "Hands of the nominal space reach out at up to 1.6 m/s, the arm gives way at 0.25 m/s: no "
            "avoider can outrun them. The row without avoidance says what giving way is worth: where few of "
            "its episodes are violated, that none of the others' is, is no evidence for giving way.",
            "Inconclusive: the hand never came near enough for the claim to be put to the test (400 mm for "
            "the 50 mm). Such an episode is no evidence and is left out of the shares.",
            f"Protective separation: that of ISO/TS 15066, for a hand at {REACHING_MPS:g} m/s, or at the "
            "hands' own speeds; it is asked of a moving arm only. A fixed critical distance of 400 mm cannot "
            "keep it.",
        ),
    )


def _kept(episodes: list[dict[str, Any]], claim: str = DISTANCE) -> dict[str, int]:
    verdicts = [one[claim]["verdict"] for one in episodes]
    return {word: verdicts.count(word) for word in ("holds", "violated", "inconclusive")}


def _violated(episodes: list[dict[str, Any]], claim: str) -> list[bool]:
    return [one[claim]["verdict"] == "violated" for one in episodes]


def _ways(ways: list[dict[str, Any]], which: str) -> Table:
    """One row a system, the mean over trainings with its interval."""
    rows = []
    for name in ways[0]:
        cells = []
        for key in ("farther", "farther_all_along", "under_250_mm"):
            shares = [
                one[name][which][key] / one[name][which]["pairs"] for one in ways if one[name][which]["pairs"]
            ]
            cells.append(_percent(mean_of(shares, "draws")) if shares else "-")
        gained = [one[name][which]["gained_m"] for one in ways if one[name][which]["gained_m"] is not None]
        cells.append(estimate_words(mean_of(gained), unit="mm", scale=1e3, digits=1) if gained else "-")
        rows.append((name, *cells))
    pairs = sum(one[OPPOSITE][which]["pairs"] for one in ways)
    what = "within the critical distance of 400 mm" if which == "near" else "at any distance"
    return Table(
        f"Hands {what}: {pairs:,} pairs of a TCP and a hand of the seen space. Distance of the repulsive "
        f"position from "
        "the hand's centre against that of the TCP before.",
        ("system", "farther at the end", "farther all along", "under 250 mm at the end", "gained"),
        tuple(rows),
    )


def _percent(estimate: Estimate) -> str:
    return estimate_words(estimate, unit="%", scale=100.0, digits=1)


def _episodes(episodes: list[dict[str, Any]], claim: str) -> Table:
    rows = []
    for (name, _, _), found in zip(SYSTEMS, episodes, strict=True):
        one = _kept(found["episodes"], claim)
        exercised = one["holds"] + one["violated"]
        violated = np.arange(exercised) < one["violated"]
        judged = [e[claim] for e in found["episodes"]]
        margins = [
            e["margin_m"] for e in judged if e["verdict"] != "inconclusive" and e["margin_m"] is not None
        ]
        moving = sum(
            e["verdict"] == "violated" and (e["tcp_speed_at_worst_mps"] or 0.0) > MOVING_MPS for e in judged
        )
        rows.append(
            (
                name,
                f"{one['violated']} of {exercised}",
                _percent(share_of(violated)) if exercised else "-",
                str(moving),
                str(one["inconclusive"]),
                f"{number(1e3 * min(margins), 0)} mm" if margins else "-",
            )
        )
    return Table(
        f"{claim[0].upper()}{claim[1:]}: episodes of ten seconds of the nominal hand space in PyBullet, the "
        f"same draws "
        "for each system. Moving: the TCP was faster than 10 mm/s at the worst moment.",
        ("system", "violated", "share (exact)", "of these, arm moving", "inconclusive", "least margin"),
        tuple(rows),
    )


def _decisions(episodes: list[dict[str, Any]]) -> Table:
    rows = []
    for (name, _, _), found in zip(SYSTEMS, episodes, strict=True):
        total = np.sum([e["decisions"] for e in found["episodes"]], axis=0)
        rows.append((name, *(str(int(count)) for count in total)))
    return Table(
        "How the decisions of these episodes ended.",
        ("system", "proposal used", "opposite pose", "stop"),
        tuple(rows),
    )


PART = Part("safety", tasks, result)
