"""Describe the result of a search in lines and sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.base import Unit, close_to, far_words
from safety_harness.claims.properties.tally import basis
from safety_harness.search.findings import Findings
from safety_harness.search.trials import Trials


def nothing_confirmed(world: WorldEntry) -> str:
    """Return a sentence which states that no installed reference can confirm findings in ``world``."""
    lacking = "other reference" if world.reference else f"reference ({REFERENCE})"
    return f"nothing is confirmed, as no {lacking} is installed: this is {world} alone"


def basis_of_search(findings: Findings, world: WorldEntry, confirmed_in: Sequence[str]) -> str:
    """Return a sentence on the worlds and the runs that produced the findings of a search.

    Args:
        findings: The findings.
        world: The searched world.
        confirmed_in: The worlds that confirm findings. It is empty if no world confirms findings.

    """
    counts = [(int(runs), findings.tried) for runs in findings.evidence]
    return basis([str(world), *confirmed_in], counts)


def counted(count: int, noun: str = "violation") -> str:
    """Return ``count`` with ``noun`` in the singular or plural.

    Here, a violation concerns one claim in one run.
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"


def nearest_lines(findings: Findings) -> list[str]:
    """Return a line for each claim.

    The line states the least margin, the number of violations and the number of verdicts.
    """
    lines = []
    for claim, goal in enumerate(findings.goals):
        nearest = findings.nearest[claim]
        margin = "no margin yet" if nearest is None else goal.margin_text(float(nearest.margins[claim]))
        kept = f", and kept by {goal.against}," if goal.against else ""
        counts = f"violated{kept} {findings.violated[claim]} of {findings.evidence[claim]} with a verdict"
        lines.append(f"  {margin:>14}  {goal.sentence}: {counts}")
    return lines


def not_found_words(findings: Findings) -> str:
    """Return a sentence on why the search may have missed an expected violation."""
    return (
        f"the space expects it to be violated, and of {findings.tried} runs none is known to do so; the "
        "system does better than the space says, or the budget is too small"
    )


def summary(findings: Findings, budget: int) -> str:
    """Return a text with the numbers of tried points, refused points, violations and kinds of run errors.

    Args:
        findings: The findings.
        budget: The number of runs.

    """
    mishaps = sum(group.claim is None for group in findings.groups)
    return (
        f"tried {findings.tried}/{budget}, refused {findings.refused.total()}, "
        f"{counted(int(findings.violated.sum()))}" + (f", {mishaps} kinds of mishap" if mishaps else "")
    )


def against_lines(against: Against, findings: Findings, touching: int, worse: Sequence[str]) -> list[str]:
    """Return lines on the differences from the reference.

    If there is no finding, the lines also explain the meaning of this result.

    Args:
        against: The differences.
        findings: The findings.
        touching: The number of runs in which a hand touched the arm.
        worse: Sentences on weaknesses of the avoider compared with the reference.

    """
    lines = [f"against {against.reference}: {line}" for line in against.lines()]
    if findings.tried and not (findings.found_any or worse):
        touch = f"; in {touching} of them a hand touched the arm" if touching else ""
        lines.append(
            f"nothing found that {against.reference} does not do as well, in {findings.tried} runs{touch}. A "
            "search estimates nothing: that is no evidence of safety in the rest of the space"
        )
    return lines


def remarks(trials: Trials, findings: Findings, worse: Sequence[str] = ()) -> list[str]:
    """Return remarks that prevent a wrong interpretation of the result.

    The remarks concern refused points, untested claims, untried parts and hands that touched the arm.

    Args:
        trials: The trials of the search.
        findings: The findings.
        worse: Sentences on weaknesses of the avoider compared with the reference.

    """
    lines = [f"{count} points refused: {reason}" for reason, count in findings.refused.most_common(3)]
    for claim, goal in enumerate(findings.goals):
        if trials.of_others[claim]:
            lines.append(f"not applicable to the controller: {goal.sentence}")
        elif findings.always_violated(claim):
            lines.append(f"every run violates {goal.sentence!r}: it is the claim or the space, no corner")
        elif findings.tried and not findings.evidence[claim]:
            lines.append(f"no run put {goal.sentence!r} to the test: nothing is known of it")
        elif (nearest := findings.nearest[claim]) is not None and trials.reference is None:
            distance = far_words(close_to(trials.properties[claim]), float(nearest.margins[claim]))
            lines += [f"{goal.sentence}: {distance}"] * bool(distance)
    lines += trials.tried.lines(trials.space)
    touching = trials.coverage.touching
    if np.isfinite(trials.nearest_hand_m):
        least = Unit.LENGTH.margin_text(trials.nearest_hand_m)
        lines.append(f"nearest hand: {least}; in {touching} of {findings.tried} runs a hand touched the arm")
    if trials.against is not None:
        lines += against_lines(trials.against, findings, touching, worse)
    elif not findings.found_any and touching:
        lines.append(
            "no claim was violated: none here says that a hand must not touch the arm (--claim 'hand "
            "distance never below 1 mm' searches for that)"
        )
    elif not findings.found_any and findings.tried:
        lines.append(
            f"nothing found in {findings.tried} runs. A search estimates nothing: that is no evidence of "
            "safety in the rest of the space"
        )
    return lines
