"""Write the evidence as a self-contained HTML page, which serves a quick reader and a thorough reader."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import replace

from markupsafe import Markup, escape

from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.argument import (
    STATE,
    UNDEVELOPED,
    argument_of,
)
from safety_harness.extensions.assurance.certification.argument_picture import argument_svg
from safety_harness.extensions.assurance.certification.evidence import (
    SEVERITY,
    CertifiedClaim,
    ClaimEvidence,
    ClaimStatus,
    CounterexampleEvidence,
    Evidence,
    OpenFinding,
    as_text,
    by_severity,
)
from safety_harness.extensions.assurance.certification.figures import (
    bounds_figure,
    margins_figure,
    separation_figure,
)
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.result_tables import confidence_alone
from safety_harness.extensions.assurance.certification.stored import cells_of
from safety_harness.extensions.assurance.certification.tables import TABLES
from safety_harness.extensions.assurance.certification.verdicts import (
    at_most,
    beside_target,
    confidence_words,
    percent,
)
from safety_harness.extensions.lab.pages.proof_page import SCALE, STATES, drawn_maps
from safety_harness.extensions.lab.pages.question_maps import key_of
from safety_harness.extensions.pages.attributions import draw_attributions
from safety_harness.extensions.pages.coverage_map import coverage_map
from safety_harness.extensions.pages.page_parts import added_sections, render_page
from safety_harness.extensions.pages.path_views import path_views, shown_moment
from safety_harness.extensions.pages.replay import Replays
from safety_harness.extensions.pages.timeline import timeline
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import count_words

MEANINGS = {
    ClaimStatus.SHOWN: "the upper bound of the violation probability is at or below the target in every "
    "stratum",
    ClaimStatus.DOUBTED: "like shown, but runs without a verdict count against it, or it concerns the model "
    "only",
    ClaimStatus.NOT_SHOWN: "the upper bound is above the target: too few runs, or too many violations",
    ClaimStatus.REFUTED: "even the lower bound is above the target",
    ClaimStatus.ESTIMATED: "the plan sets no target, so the report only estimates",
    ClaimStatus.UNTESTED: "no run exercised it, so nothing is known about it",
    ClaimStatus.INCOMPLETE: "declared runs are missing, so there is no bound yet",
}

MOST_LED = 3  # findings in view; the page folds the rest
MOST_OPEN = 2  # counterexamples that the page draws when it opens
# Without --full, a printed page has at most so many items of each kind, the most severe first.
MOST_PRINTED, MOST_PRINTED_CLAIMS, MOST_PRINTED_ROWS = 3, 4, 25


def _meanings(evidence: Evidence) -> dict[ClaimStatus, str]:
    """Return the meaning of each status.

    If the system has an avoider, the meaning of the status DOUBTED also mentions the fallback.
    """
    stood_in = ", or the fallback in the avoider's place" if evidence.system.asks else ""
    return MEANINGS | {ClaimStatus.DOUBTED: MEANINGS[ClaimStatus.DOUBTED] + stood_in}


def render(evidence: Evidence, runs: Mapping[int, JudgedRun]) -> str:
    """Return only the page from the result of ``drawn``.

    Equal arguments give equal bytes.
    """
    return drawn(evidence, runs)[0]


def drawn(evidence: Evidence, runs: Mapping[int, JudgedRun]) -> tuple[str, Evidence]:
    """Return the page as text, and the evidence with a finding for each part that could not be drawn.

    The page loads no data over the network. If the whole page cannot be drawn, the result is a page that
    shows only the JSON.

    Args:
        evidence: The evidence.
        runs: The run of each counterexample, by the number of the counterexample.

    """
    guard = ReportGuard()
    page = guard.run("the page", lambda: _page(evidence, runs, guard), "")
    if guard.findings:  # the page has to show them, too
        new = tuple(finding for finding in guard.findings if finding not in evidence.findings)
        evidence = replace(evidence, findings=(*evidence.findings, *new))
        page = page and guard.run("the page", lambda: _page(evidence, runs, ReportGuard()), "")
    return page or f"<!DOCTYPE html><title>Evidence</title><pre>{escape(as_text(evidence))}</pre>", evidence


def _page(evidence: Evidence, runs: Mapping[int, JudgedRun], guard: ReportGuard) -> str:
    """Return the page.

    If a picture cannot be drawn, the picture is empty and ``guard`` records a finding.
    """

    def picture(name: str, draw: Callable[[], str]) -> Markup:
        return Markup(guard.run(f"the picture of {name}", draw, ""))

    top = argument_of(evidence)
    replays = Replays()
    views = [_counterexample(met, runs.get(met.number), replays, guard) for met in evidence.counterexamples]
    return render_page(
        "evidence.html.j2",
        package="safety_harness.extensions.assurance",
        basis=evidence.basis,
        style="evidence.css",
        scripts=("evidence.js", "coverage.js"),
        replays=any(view["run"] for view in views),
        evidence=evidence,
        state=STATE,
        undeveloped=UNDEVELOPED,
        counts=_counts(evidence),
        answer=_answer(evidence),
        at_most=at_most,
        beside_target=beside_target,
        claims=by_severity(evidence.claims),
        findings=_by_gravity(evidence),
        alone=confidence_alone(evidence),
        query=lambda claim: shlex.join(
            ["safety-harness", "campaign", "query", LEDGER, "--claim", claim, "--outcome", "violated"]
        ),
        most_led=MOST_LED,
        most_open=MOST_OPEN,
        most_printed=MOST_PRINTED,
        most_printed_claims=MOST_PRINTED_CLAIMS,
        most_printed_rows=MOST_PRINTED_ROWS,
        meanings=_meanings(evidence),
        tables=TABLES,
        bounds_figure=lambda *given: picture("bounds", lambda: bounds_figure(*given)),
        margins_figure=lambda *given: picture("margins", lambda: margins_figure(*given)),
        counterexamples=views,
        faults_picture=picture(
            "the attribution", lambda: draw_attributions(dict(evidence.whose_fault.groups))
        ),
        top=top,
        argument=picture("the argument", lambda: argument_svg(top, prefix="argument-")),
        separation=picture("the separation", lambda: separation_figure(evidence.separation)),
        coverage_map=picture(
            "the coverage",
            lambda: coverage_map(
                *cells_of(evidence.coverage),
                prefix="coverage-map-",
                title="Coverage of the domain by the declared runs",
            ),
        ),
        percent=percent,
        added_sections=added_sections("evidence", evidence),
        proven=guard.run("the picture of what is proven", lambda: _proven(evidence), []),
        proven_key=Markup(key_of(SCALE)),
        confidence=confidence_words,
    )


def _counts(evidence: Evidence) -> list[tuple[str, str, list[ClaimEvidence]]]:
    """Return a triple (label, CSS class, claims) for each of the four numbers at the top of the page."""
    open_ones = (ClaimStatus.NOT_SHOWN, ClaimStatus.INCOMPLETE, ClaimStatus.ESTIMATED, ClaimStatus.DOUBTED)
    return [
        (label, css, [claim for claim in by_severity(evidence.claims) if claim.standing in statuses])
        for label, css, statuses in (
            ("shown", "holds", (ClaimStatus.SHOWN,)),
            ("refuted", "violated", (ClaimStatus.REFUTED,)),
            ("open", "inconclusive", open_ones),
            ("never tested", "violated", (ClaimStatus.UNTESTED,)),
        )
    ]


def _answer(evidence: Evidence) -> str:
    """Return a sentence with the result.

    Claims with the most severe status come first, and decide the status of the plan.
    """
    standings = [claim.standing for claim in evidence.claims]
    parts = (f"{standings.count(kind)} {kind.value}" for kind in reversed(SEVERITY) if kind in standings)
    claims = count_words(len(standings), "claim", "claims")
    return f"{claims}: {', '.join(parts)}. The gravest verdict decides for the whole plan."


def _by_gravity(evidence: Evidence) -> list[OpenFinding]:
    """Return the findings in the order of severity, beginning with the most severe finding.

    A finding that concerns no claim is placed between the statuses NOT_SHOWN and DOUBTED.
    """
    grave = {f"claim-{item.number}": SEVERITY.index(item.standing) for item in evidence.claims}
    beside = SEVERITY.index(ClaimStatus.NOT_SHOWN) - 0.5
    return sorted(evidence.findings, key=lambda item: -grave.get(item.place, beside))


def _proven(evidence: Evidence) -> list[tuple[CertifiedClaim, str, list[tuple[str, Markup]]]]:
    """Return a triple (claim, state, maps) for each claim of the certificate."""
    claims = () if evidence.proven is None else evidence.proven.claims
    return [
        (claim, STATES.get(claim.verdict, "inconclusive"), list(drawn_maps(claim.maps, f"proven-{number}-")))
        for number, claim in enumerate(claims)
    ]


def _counterexample(
    met: CounterexampleEvidence, run: JudgedRun | None, replays: Replays, guard: ReportGuard
) -> dict[str, object]:
    """Return a counterexample with its pictures.

    If no trace is stored, there are no pictures.
    """
    none: dict[str, object] = {"run": None, "moment": ""}
    if run is None or len(run.trace.ticks) == 0:
        return {"one": met} | none
    part = f"the pictures of counterexample {met.number}"
    shown = run.under_claim(met.sentence)
    return {"one": met} | guard.run(part, lambda: _pictures(met, shown, replays), none)


def _pictures(met: CounterexampleEvidence, run: JudgedRun, replays: Replays) -> dict[str, object]:
    """Return the views, the timeline and the replay of a counterexample, and its most important moment."""
    prefix = f"counterexample-{met.number}-"
    moment = shown_moment(run)
    return {
        "run": run,
        "views": path_views(run, prefix=prefix),
        "timeline": Markup(timeline(run, prefix=f"{prefix}time-")),
        "replay": replays.arguments(run, prefix.removesuffix("-")),
        "moment": "" if moment is None else f"{moment.time_s:.3f}",
        "moment_name": "Nearest hand" if moment is None or moment.claim is None else "Worst moment",
    }
