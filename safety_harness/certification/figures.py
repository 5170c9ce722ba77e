"""The figures of the evidence report: bounds, margins and protective separation, in the page's colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from safety_harness.certification.evidence import ClaimEvidence, ClaimResult, SeparationCase
from safety_harness.certification.verdicts import at_least, at_most, percent
from safety_harness.report.svg import DASHES, Ink, drawing, new_figure, plain, to_svg
from safety_harness.report.words import with_minus

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LANE_PX, ABOVE_PX, BELOW_PX, LEFT_PX, WIDTH_PX = 30.0, 30.0, 46.0, 190.0, 760.0
LIMIT_LINE: dict[str, Any] = {"color": Ink.LIMIT.sentinel, "linewidth": 1.4, "linestyle": (0, (4, 3))}
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
    """The interval of the probability of a violation in each stratum, with the target; empty without any."""
    rows = [outcome for outcome in claim.outcomes if outcome.bound is not None]
    if not rows:
        return ""
    with drawing():
        figure, axes = _lanes([outcome.stratum for outcome in rows])
        least = min(_least_shown(outcome) for outcome in rows)
        if claim.target is not None:
            least = min(least, claim.target / 3.0)
        axes.set_xscale("log")
        low, decades, names = _decades(least)
        axes.set_xlim(low, 1.0)
        for lane, outcome in enumerate(rows):
            _interval(axes, lane, outcome, low)
        if claim.target is not None:
            axes.axvline(claim.target, **LIMIT_LINE)
            axes.annotate(
                f"target {percent(claim.target)}",
                (claim.target, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 5),
                textcoords="offset points",
                ha="center",
                color=Ink.LIMIT.sentinel,
            )
        axes.set_xticks(decades, names)
        axes.set_xlabel(
            "probability of a violation, given that the run put the claim to the test", loc="right"
        )
        described = "; ".join(
            f"{o.stratum}: {at_least(o.bound.lower)} to {at_most(o.bound.upper)}" for o in rows if o.bound
        )
        return to_svg(
            figure,
            prefix=f"claim-{claim.number}-bounds-",
            title=f"Bounds of the probability that a run violates: {claim.sentence}",
            description=described,
        )


def _lanes(names: list[str]) -> tuple[Figure, Axes]:
    """Axes with a lane for each name, from the top down."""
    count = len(names)
    height = ABOVE_PX + LANE_PX * count + BELOW_PX
    figure = new_figure(WIDTH_PX, height)
    width = (WIDTH_PX - LEFT_PX - 20.0) / WIDTH_PX
    axes = figure.add_axes((LEFT_PX / WIDTH_PX, BELOW_PX / height, width, LANE_PX * count / height))
    axes.set_ylim(count - 0.4, -0.6)
    axes.set_yticks(range(count), [plain(name, longest=26) for name in names])
    axes.tick_params(axis="y", length=0, pad=10)
    axes.spines["left"].set_visible(False)
    axes.grid(True, axis="x")
    return figure, axes


def _decades(share: float) -> tuple[float, list[float], list[str]]:
    """Where a logarithmic axis of shares begins, a tenth at most so that it has a length; and its ticks."""
    low = float(10.0 ** min(np.floor(np.log10(share)), -1.0))
    decades = [10.0**k for k in range(round(np.log10(low)), 1)]
    return low, decades, [percent(decade) for decade in decades]


def _least_shown(outcome: ClaimResult) -> float:
    assert outcome.bound is not None
    share = outcome.violated / outcome.tested if outcome.tested else 0.0
    known = [value for value in (outcome.bound.lower, share) if value > 0.0]
    return max(min(known, default=outcome.bound.upper / 10.0), 1e-9)


def _interval(axes: Axes, lane: int, outcome: ClaimResult, low: float) -> None:
    """A bar from bound to bound (an arrow to the left where the lower one is zero) and the share as a dot."""
    assert outcome.bound is not None
    start, end = max(outcome.bound.lower, low), outcome.bound.upper
    style: dict[str, Any] = {"color": Ink.TCP.sentinel, "markeredgewidth": 2.4}
    axes.plot([start, end], [lane, lane], color=Ink.TCP.sentinel, linewidth=2.4)
    axes.plot(end, lane, marker="|", markersize=13, **style)
    marker, size = ("<", 7) if outcome.bound.lower < low else ("|", 13)
    axes.plot(start, lane, marker=marker, markersize=size, clip_on=False, **style)
    share = outcome.violated / outcome.tested if outcome.tested else 0.0
    if share > low:
        axes.plot(share, lane, marker="o", markersize=7, color=Ink.TEXT.sentinel)


def margins_figure(claim: ClaimEvidence) -> str:
    """The share of runs with no larger margin, one curve a stratum; empty without margins."""
    rows = [outcome for outcome in claim.outcomes if outcome.margins_si]
    if not rows:
        return ""
    with drawing():
        figure = new_figure(WIDTH_PX, 280.0)
        axes = figure.add_axes((70.0 / WIDTH_PX, 46.0 / 280.0, 670.0 / WIDTH_PX, 200.0 / 280.0))
        for k, outcome in enumerate(rows):
            values = np.array(outcome.margins_si) * claim.per_si
            axes.step(
                values,
                outcome.shares,
                where="post",
                color=CURVES[k % len(CURVES)].sentinel,
                linestyle=DASHES[k % len(DASHES)],
                linewidth=1.8,
                label=plain(outcome.stratum, longest=26),
            )
        axes.axvline(0.0, **LIMIT_LINE)
        low, decades, names = _decades(min(outcome.shares[0] for outcome in rows))
        axes.set_yscale("log")
        axes.set_ylim(low, 1.0)
        axes.set_yticks(decades, names)
        axes.grid(True)
        axes.xaxis.set_major_formatter(lambda value, _: with_minus(f"{value + 0.0:g}"))
        axes.set_xlabel(
            f"margin, {claim.unit}; left of the line the claim is violated".replace(", ;", ";"), loc="right"
        )
        axes.set_title("Share of runs with no larger margin", loc="left", fontsize=11, fontweight="bold")
        if len(rows) > 1:
            axes.legend(loc="lower right", frameon=False)
        return to_svg(
            figure,
            prefix=f"claim-{claim.number}-margins-",
            title=f"Margins of all independent runs: {claim.sentence}",
            description="; ".join(
                f"{o.stratum}: least {with_minus(f'{o.margins_si[0] * claim.per_si:.1f}')} {claim.unit}"
                for o in rows
            ),
        )


def separation_figure(cases: tuple[SeparationCase, ...]) -> str:
    """What the protective separation distance is made of in each case, and the distance that there was."""
    if not cases:
        return ""
    from matplotlib.patches import Patch

    with drawing():
        figure, axes = _lanes([case.stratum for case in cases])
        for lane, case in enumerate(cases):
            start = 0.0
            for term in case.terms:
                length_mm, colour = term.length_m * 1e3, _term_colour(term.symbol)
                axes.barh(lane, length_mm, left=start, height=0.56, color=colour)
                start += length_mm
            there_mm, ends = case.distance_m * 1e3, [lane - 0.4, lane + 0.4]
            axes.plot([there_mm, there_mm], ends, color=Ink.TEXT.sentinel, linewidth=2.6)
        axes.set_xlabel("mm; the upright line is the distance that there was", loc="right")
        terms = [term for case in cases for term in case.terms if term.length_m > 0.0]
        used = list(dict.fromkeys(term.symbol for term in terms))
        axes.legend(
            [Patch(facecolor=_term_colour(symbol)) for symbol in used],
            [symbol.replace("_", "") for symbol in used],
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=max(len(used), 1),
            frameon=False,
            borderaxespad=0.0,
        )
        return to_svg(
            figure,
            prefix="separation-",
            title="Protective separation distance by term",
            description="; ".join(
                f"{case.stratum}: {case.required_m * 1e3:.0f} mm needed, {case.distance_m * 1e3:.0f} mm there"
                for case in cases
            ),
        )


def _term_colour(symbol: str) -> str:
    return TERM_INKS.get(symbol, Ink.MUTED).sentinel
