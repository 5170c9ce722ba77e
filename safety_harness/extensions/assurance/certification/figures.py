"""The figures of the evidence report: bounds, margins and protective separation, in the page's colours."""

from __future__ import annotations

import numpy as np

from safety_harness.extensions.assurance.certification.evidence import (
    ClaimEvidence,
    ClaimResult,
    SeparationCase,
)
from safety_harness.extensions.assurance.certification.verdicts import at_least, at_most, percent
from safety_harness.extensions.pages.axes import Axes, Axis, Picture, Share, stairs
from safety_harness.extensions.pages.svg import DASHES, Ink, plain
from safety_harness.report.words import with_minus

LANE_PX, ABOVE_PX, BELOW_PX, LEFT_PX, WIDTH_PX = 30.0, 30.0, 46.0, 190.0, 760.0
LIMIT_DASHES = 4, 3
CURVES = (Ink.TCP, Ink.HAND_1, Ink.GREEN, Ink.HAND_2, Ink.PREDICTED, Ink.SKY)
TERM_INKS = {
    "S_h": Ink.HAND_1,
    "S_r": Ink.TCP,
    "S_s": Ink.SKY,
    "C": Ink.MUTED,
    "Z_d": Ink.PREDICTED,
    "Z_r": Ink.HAND_2,
}


def bounds_figure(claim: ClaimEvidence) -> str:
    """Return the SVG of a claim's target and of its bounds in each stratum, or "" if there is no bound.

    A bound is an interval of the violation probability.
    """
    rows = [outcome for outcome in claim.outcomes if outcome.bound is not None]
    if not rows:
        return ""
    picture, axes = _lanes([outcome.stratum for outcome in rows])
    least = min(_least_shown(outcome) for outcome in rows)
    if claim.target is not None:
        least = min(least, claim.target / 3.0)
    low = _show_shares(axes.x, least)
    for lane, outcome in enumerate(rows):
        _interval(axes, lane, outcome, low)
    if claim.target is not None:
        axes.vline(claim.target, Ink.LIMIT, width=1.4, dashes=LIMIT_DASHES)
        label = f"target {percent(claim.target)}"
        axes.text(label, claim.target, Share(1.0), shift=(0.0, -6.0), anchor="middle", ink=Ink.LIMIT)
    axes.x.label = "probability of a violation in a run that exercises the claim"
    described = "; ".join(
        f"{o.stratum}: {at_least(o.bound.lower)} to {at_most(o.bound.upper)}" for o in rows if o.bound
    )
    return picture.svg(
        prefix=f"claim-{claim.number}-bounds-",
        title=f"Bounds of the probability that a run violates: {claim.sentence}",
        description=described,
    )


def _lanes(names: list[str]) -> tuple[Picture, Axes]:
    """Return a picture and its axes.

    The axes have a lane for each of ``names``, from the top down.
    """
    count = len(names)
    picture = Picture(WIDTH_PX, ABOVE_PX + LANE_PX * count + BELOW_PX)
    axes = picture.axes(LEFT_PX, ABOVE_PX, WIDTH_PX - LEFT_PX - 20.0, LANE_PX * count)
    axes.y.show(count - 0.4, -0.6)
    axes.y.ticks = [(lane, plain(name, longest=26)) for lane, name in enumerate(names)]
    axes.y.line = False
    axes.x.grid = True
    return picture, axes


def _show_shares(axis: Axis, share: float) -> float:
    """Give ``axis`` a logarithmic scale that ends at 1, and return the value at its lower end.

    The lower end is at most ``share`` and at most 0.1, so that the axis has a positive length.
    """
    decades = [10.0**k for k in range(min(int(np.floor(np.log10(share))), -1), 1)]
    axis.log, axis.ticks = True, [(decade, percent(decade)) for decade in decades]
    axis.show(decades[0], 1.0)
    return decades[0]


def _least_shown(outcome: ClaimResult) -> float:
    """Return the least positive value to draw.

    This value is the lower bound, the fraction of violations, or a tenth of the upper bound.
    """
    assert outcome.bound is not None
    share = outcome.violated / outcome.tested if outcome.tested else 0.0
    known = [value for value in (outcome.bound.lower, share) if value > 0.0]
    return max(min(known, default=outcome.bound.upper / 10.0), 1e-9)


def _interval(axes: Axes, lane: int, outcome: ClaimResult, low: float) -> None:
    """Draw a bar from the lower to the upper bound, and a dot at the fraction of violations.

    The axis begins at ``low``. If the lower bound is below ``low``, an arrow points to the left.
    """
    assert outcome.bound is not None
    start, end = max(outcome.bound.lower, low), outcome.bound.upper
    axes.line([start, end], [lane, lane], Ink.TCP, width=2.4)
    axes.marks([end], [lane], "|", 13, edge=Ink.TCP, width=2.4)
    shape, size = ("<", 7) if outcome.bound.lower < low else ("|", 13)
    axes.marks([start], [lane], shape, size, fill=Ink.TCP, edge=Ink.TCP, width=2.4)
    share = outcome.violated / outcome.tested if outcome.tested else 0.0
    if share > low:
        axes.marks([share], [lane], "o", 7, fill=Ink.TEXT)


def margins_figure(claim: ClaimEvidence) -> str:
    """Return the SVG of a claim's margins with one curve per stratum, or "" if there are no margins.

    At each margin, a curve shows the fraction of runs whose margin is not larger.
    """
    rows = [outcome for outcome in claim.outcomes if outcome.margins_si]
    if not rows:
        return ""
    picture = Picture(WIDTH_PX, 280.0)
    axes = picture.axes(70.0, 34.0, 670.0, 200.0)
    for k, outcome in enumerate(rows):
        x, y = stairs(np.array(outcome.margins_si) * claim.per_si, outcome.shares)
        name = plain(outcome.stratum, longest=26)
        axes.line(x, y, CURVES[k % len(CURVES)], width=1.8, dashes=DASHES[k % len(DASHES)], name=name)
    axes.vline(0.0, Ink.LIMIT, width=1.4, dashes=LIMIT_DASHES)
    _show_shares(axes.y, min(outcome.shares[0] for outcome in rows))
    axes.x.grid = axes.y.grid = True
    axes.x.steps = 8
    axes.x.label = f"margin, {claim.unit}; left of the line the claim is violated".replace(", ;", ";")
    axes.title("Share of runs with no larger margin")
    if len(rows) > 1:
        axes.legend(inside=True)
    return picture.svg(
        prefix=f"claim-{claim.number}-margins-",
        title=f"Margins of all independent runs: {claim.sentence}",
        description="; ".join(
            f"{o.stratum}: least {with_minus(f'{o.margins_si[0] * claim.per_si:.1f}')} {claim.unit}"
            for o in rows
        ),
    )


def separation_figure(cases: tuple[SeparationCase, ...]) -> str:
    """Return an SVG with the terms of the protective separation distance and the real distance in each case.

    The text is empty if there are no ``cases``.
    """
    if not cases:
        return ""
    picture, axes = _lanes([case.stratum for case in cases])
    for lane, case in enumerate(cases):
        start = 0.0
        for term in case.terms:
            length_mm = term.length_m * 1e3
            axes.bars([(start, length_mm)], (lane - 0.28, lane + 0.28), _term_ink(term.symbol))
            start += length_mm
        there_mm = case.distance_m * 1e3
        axes.line([there_mm, there_mm], [lane - 0.4, lane + 0.4], Ink.TEXT, width=2.6)
        axes.x.see([0.0, start])
    axes.x.show(0.0, axes.x.view()[1])
    axes.x.steps = 8
    axes.x.label = "mm; the upright line is the actual distance"
    for symbol in dict.fromkeys(term.symbol for case in cases for term in case.terms if term.length_m > 0.0):
        axes.key(symbol.replace("_", ""), _term_ink(symbol))
    axes.legend()
    return picture.svg(
        prefix="separation-",
        title="Protective separation distance by term",
        description="; ".join(
            f"{case.stratum}: {case.required_m * 1e3:.0f} mm needed, {case.distance_m * 1e3:.0f} mm there"
            for case in cases
        ),
    )


def _term_ink(symbol: str) -> Ink:
    return TERM_INKS.get(symbol, Ink.MUTED)
