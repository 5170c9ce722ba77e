"""One self-contained HTML page of the evidence, for a reader in a hurry and for one with a day."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup

from safety_harness.certification.argument import STATE, argument_of, argument_svg
from safety_harness.certification.evidence import (
    CertifiedClaim,
    ClaimStatus,
    CounterexampleEvidence,
    Evidence,
)
from safety_harness.certification.figures import bounds_figure, margins_figure, separation_figure
from safety_harness.certification.stored import cells_of
from safety_harness.certification.tables import TABLES
from safety_harness.certification.verdicts import confidence_words, percent
from safety_harness.report.attribution_picture import draw_attributions
from safety_harness.report.coverage_map import coverage_map
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.page_parts import render_page
from safety_harness.report.path_views import path_views, shown_moment
from safety_harness.report.proof_page import SCALE, STATES, drawn_maps
from safety_harness.report.question_maps import key_of
from safety_harness.report.replay import Replays
from safety_harness.report.timeline import timeline
from safety_harness.whole_file import write_whole

MEANINGS = {
    ClaimStatus.SHOWN: "the upper bound of the violation probability is at or below the target in every "
    "stratum",
    ClaimStatus.DOUBTED: "so it is, but runs without a verdict count against it, or it is about the model "
    "only",
    ClaimStatus.NOT_SHOWN: "the upper bound is above the target: too few runs, or too many violations",
    ClaimStatus.REFUTED: "even the lower bound is above the target",
    ClaimStatus.ESTIMATED: "the plan sets no target, so there is nothing to be shown",
    ClaimStatus.UNTESTED: "no run gave it an occasion: nothing is known of it",
    ClaimStatus.INCOMPLETE: "declared runs are missing, so there is no bound yet",
}


def write_page(path: Path, evidence: Evidence, runs: Mapping[int, JudgedRun]) -> None:
    """Write the page whole or not at all; it asks nothing of the network.  Raises OSError."""
    write_whole(path, render(evidence, runs))


def _meanings(evidence: Evidence) -> dict[ClaimStatus, str]:
    stood_in = ", or about the fallback in the avoider's place" if evidence.system.asks else ""
    return MEANINGS | {ClaimStatus.DOUBTED: MEANINGS[ClaimStatus.DOUBTED] + stood_in}


def render(evidence: Evidence, runs: Mapping[int, JudgedRun]) -> str:
    """The page as text; ``runs`` are those of counterexamples, by their numbers.

    The same arguments give the same bytes.
    """
    top = argument_of(evidence)
    replays = Replays()
    views = [_counterexample(one, runs.get(one.number), replays) for one in evidence.counterexamples]
    return render_page(
        "evidence.html.j2",
        style="evidence.css",
        scripts=("evidence.js",),
        replays=any(view["run"] for view in views),
        evidence=evidence,
        state=STATE,
        counts=_counts(evidence),
        meanings=_meanings(evidence),
        tables=TABLES,
        bounds_figure=bounds_figure,
        margins_figure=margins_figure,
        counterexamples=views,
        faults_picture=Markup(draw_attributions(dict(evidence.whose_fault.groups))),
        top=top,
        argument=Markup(argument_svg(top, prefix="argument-")),
        separation=Markup(separation_figure(evidence.separation)),
        coverage_map=Markup(
            coverage_map(
                *cells_of(evidence.coverage),
                prefix="coverage-map-",
                title="Coverage of the domain by the declared runs",
            )
        ),
        percent=percent,
        proven=_proven(evidence),
        proven_key=Markup(key_of(SCALE)),
        confidence=confidence_words,
    )


def _counts(evidence: Evidence) -> list[tuple[str, str, int]]:
    """(words, class, claims) for the four numbers at the top."""
    standings = [claim.standing for claim in evidence.claims]
    open_ones = (ClaimStatus.NOT_SHOWN, ClaimStatus.INCOMPLETE, ClaimStatus.ESTIMATED, ClaimStatus.DOUBTED)
    return [
        ("shown", "holds", standings.count(ClaimStatus.SHOWN)),
        ("refuted", "violated", standings.count(ClaimStatus.REFUTED)),
        ("open", "inconclusive", sum(standings.count(one) for one in open_ones)),
        ("never tested", "violated", standings.count(ClaimStatus.UNTESTED)),
    ]


def _proven(evidence: Evidence) -> list[tuple[CertifiedClaim, str, list[tuple[str, Markup]]]]:
    """Each claim of the certificate with its state and its maps."""
    claims = () if evidence.proven is None else evidence.proven.claims
    return [
        (one, STATES.get(one.verdict, "inconclusive"), list(drawn_maps(one.maps, f"proven-{number}-")))
        for number, one in enumerate(claims)
    ]


def _counterexample(
    one: CounterexampleEvidence, run: JudgedRun | None, replays: Replays
) -> dict[str, object]:
    """With its pictures; without a stored trace there are none."""
    if run is None or len(run.trace.ticks) == 0:
        return {"one": one, "run": None, "moment": ""}
    run = run.under(one.sentence)
    prefix = f"counterexample-{one.number}-"
    moment = shown_moment(run)
    return {
        "one": one,
        "run": run,
        "views": path_views(run, prefix=prefix),
        "timeline": Markup(timeline(run, prefix=f"{prefix}time-")),
        "replay": replays.of(run, prefix.removesuffix("-")),
        "moment": "" if moment is None else f"{moment.time_s:.3f}",
        "moment_name": "Nearest hand" if moment is None or moment.claim is None else "Worst moment",
    }
