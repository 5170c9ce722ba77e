"""One self-contained HTML page of the evidence, for a reader in a hurry and for one with a day."""

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
    by_gravity,
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
from safety_harness.report.coverage_map import coverage_map
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.page_parts import added_sections, render_page
from safety_harness.report.path_views import path_views, shown_moment
from safety_harness.report.replay import Replays
from safety_harness.report.search_attribution import draw_attributions
from safety_harness.report.timeline import timeline

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

MOST_LED = 3  # findings before the rest folds
MOST_OPEN = 2  # counterexamples that are drawn as the page opens
# Without --full a printed page has so many of each, the gravest first.
MOST_PRINTED, MOST_PRINTED_CLAIMS, MOST_PRINTED_ROWS = 3, 4, 25


def _meanings(evidence: Evidence) -> dict[ClaimStatus, str]:
    stood_in = ", or about the fallback in the avoider's place" if evidence.system.asks else ""
    return MEANINGS | {ClaimStatus.DOUBTED: MEANINGS[ClaimStatus.DOUBTED] + stood_in}


def render(evidence: Evidence, runs: Mapping[int, JudgedRun]) -> str:
    """The page of ``drawn`` as text: the same arguments give the same bytes."""
    return drawn(evidence, runs)[0]


def drawn(evidence: Evidence, runs: Mapping[int, JudgedRun]) -> tuple[str, Evidence]:
    """Return the page as text, and the evidence with a finding for each part that could not be drawn.

    It asks nothing of the network.  ``runs`` are those of counterexamples, by their numbers.  A page that
    cannot be made at all has the evidence as it is in the JSON.
    """
    guard = ReportGuard()
    page = guard.of("the page", lambda: _page(evidence, runs, guard), "")
    if guard.findings:  # which the page has to name, too
        new = tuple(one for one in guard.findings if one not in evidence.findings)
        evidence = replace(evidence, findings=(*evidence.findings, *new))
        page = page and guard.of("the page", lambda: _page(evidence, runs, ReportGuard()), "")
    return page or f"<!DOCTYPE html><title>Evidence</title><pre>{escape(as_text(evidence))}</pre>", evidence


def _page(evidence: Evidence, runs: Mapping[int, JudgedRun], guard: ReportGuard) -> str:
    def picture(what: str, draw: Callable[[], str]) -> Markup:
        return Markup(guard.of(f"the picture of {what}", draw, ""))

    top = argument_of(evidence)
    replays = Replays()
    views = [_counterexample(one, runs.get(one.number), replays, guard) for one in evidence.counterexamples]
    return render_page(
        "evidence.html.j2",
        of="safety_harness.extensions.assurance",
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
        claims=by_gravity(evidence.claims),
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
        proven=guard.of("the picture of what is proven", lambda: _proven(evidence), []),
        proven_key=Markup(key_of(SCALE)),
        confidence=confidence_words,
    )


def _counts(evidence: Evidence) -> list[tuple[str, str, list[ClaimEvidence]]]:
    """(words, class, claims) for the four numbers at the top."""
    open_ones = (ClaimStatus.NOT_SHOWN, ClaimStatus.INCOMPLETE, ClaimStatus.ESTIMATED, ClaimStatus.DOUBTED)
    return [
        (words, css, [claim for claim in by_gravity(evidence.claims) if claim.standing in which])
        for words, css, which in (
            ("shown", "holds", (ClaimStatus.SHOWN,)),
            ("refuted", "violated", (ClaimStatus.REFUTED,)),
            ("open", "inconclusive", open_ones),
            ("never tested", "violated", (ClaimStatus.UNTESTED,)),
        )
    ]


def _answer(evidence: Evidence) -> str:
    """In one sentence, the gravest first; the worst claim decides."""
    standings = [claim.standing for claim in evidence.claims]
    words = (f"{standings.count(one)} {one.value}" for one in reversed(SEVERITY) if one in standings)
    claims = "the plan's one claim" if len(standings) == 1 else f"{len(standings)} claims"
    return f"Of {claims}: {', '.join(words)}. The plan as a whole stands as its gravest claim does."


def _by_gravity(evidence: Evidence) -> list[OpenFinding]:
    """The gravest first: whatever is open beside the claims comes after those that are not shown."""
    grave = {f"claim-{one.number}": SEVERITY.index(one.standing) for one in evidence.claims}
    beside = SEVERITY.index(ClaimStatus.NOT_SHOWN) - 0.5
    return sorted(evidence.findings, key=lambda one: -grave.get(one.place, beside))


def _proven(evidence: Evidence) -> list[tuple[CertifiedClaim, str, list[tuple[str, Markup]]]]:
    """Each claim of the certificate with its state and its maps."""
    claims = () if evidence.proven is None else evidence.proven.claims
    return [
        (one, STATES.get(one.verdict, "inconclusive"), list(drawn_maps(one.maps, f"proven-{number}-")))
        for number, one in enumerate(claims)
    ]


def _counterexample(
    one: CounterexampleEvidence, run: JudgedRun | None, replays: Replays, guard: ReportGuard
) -> dict[str, object]:
    """With its pictures; without a stored trace there are none."""
    none: dict[str, object] = {"run": None, "moment": ""}
    if run is None or len(run.trace.ticks) == 0:
        return {"one": one} | none
    what = f"the pictures of counterexample {one.number}"
    return {"one": one} | guard.of(what, lambda: _pictures(one, run.under(one.sentence), replays), none)


def _pictures(one: CounterexampleEvidence, run: JudgedRun, replays: Replays) -> dict[str, object]:
    prefix = f"counterexample-{one.number}-"
    moment = shown_moment(run)
    return {
        "run": run,
        "views": path_views(run, prefix=prefix),
        "timeline": Markup(timeline(run, prefix=f"{prefix}time-")),
        "replay": replays.of(run, prefix.removesuffix("-")),
        "moment": "" if moment is None else f"{moment.time_s:.3f}",
        "moment_name": "Nearest hand" if moment is None or moment.claim is None else "Worst moment",
    }
