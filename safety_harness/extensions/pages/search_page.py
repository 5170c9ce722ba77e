"""Write one self-contained HTML page about a search for violations, in the style of the reports."""

from __future__ import annotations

import shlex
from math import isfinite
from pathlib import Path
from typing import Any

from markupsafe import Markup

from safety_harness.admission.avoiders import replay_command
from safety_harness.base.exceptions import described
from safety_harness.base.proportions import share_words
from safety_harness.base.whole_file import write_text
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.extensions.pages.attributions import draw_attributions
from safety_harness.extensions.pages.axes import Axes, Picture, stairs
from safety_harness.extensions.pages.coverage_map import coverage_map
from safety_harness.extensions.pages.page_parts import MOST_OPEN, asset, render_page
from safety_harness.extensions.pages.path_views import path_views, shown_moment, widest_view
from safety_harness.extensions.pages.replay import Replays
from safety_harness.extensions.pages.svg import DASHES, Ink, plain, standalone
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.search_evidence import SearchEvidence
from safety_harness.report.words import margin_words, with_minus
from safety_harness.scenario.files import display_path
from safety_harness.search.confirm import Complaint, InOneWorld
from safety_harness.search.counterexample import DRAWS
from safety_harness.search.findings import Findings, Group
from safety_harness.search.result_lines import basis_of_search, not_found_words
from safety_harness.search.written import WrittenCounterexample
from safety_harness.trace.trace import Trace

MOST_GROUPS = 100  # rows in the table of violations
WIDTH_PX, PANEL_PX, TOP_PX, GAP_PX, LEFT_PX, RIGHT_PX = 960.0, 130.0, 30.0, 62.0, 76.0, 20.0
INKS = (Ink.TCP, Ink.HAND_2)  # the search, the baseline


def render(evidence: SearchEvidence) -> str:
    """Return the page as text.

    The same evidence always results in the same bytes.
    """
    findings, baseline = evidence.findings, evidence.baseline
    searches = [findings] if baseline is None else [findings, baseline]
    replays = Replays()
    return render_page(
        "search.html.j2",
        basis=basis_of_search(
            findings, evidence.searched, evidence.confirmed_in if evidence.confirmed else ()
        ),
        style="search.css",
        scripts=("coverage.js",),
        replays=bool(evidence.shown),
        e=evidence,
        searches=searches,
        claims=[
            (goal.sentence, [_claim_line(findings, k) for findings in searches])
            for k, goal in enumerate(findings.goals)
        ],
        always=[g.sentence for k, g in enumerate(findings.goals) if findings.always_violated(k)],
        untested=[
            g.sentence for k, g in enumerate(findings.goals) if findings.tried and not findings.evidence[k]
        ],
        progress=Markup(progress_figure(searches, prefix="progress-")),
        sections=[_section(shown, number, replays) for number, shown in enumerate(evidence.shown, start=1)],
        groups=[
            _group_row(findings, group)
            for claim in (*range(len(findings.goals)), None)
            for group in findings.of_claim(claim)
        ][:MOST_GROUPS],
        unconfirmed=[_group_row(findings, example.group) for example in evidence.unconfirmed],
        apart=[
            [
                _view_of(example.complaint, run, f"apart-{number}-{world}-")
                for world, run in enumerate((example.searched, example.confirming))
            ]
            for number, example in enumerate(evidence.unconfirmed, start=1)
            if example.searched is not None
        ],
        map=Markup(map_of(evidence)),
        faults_picture=Markup(
            "" if evidence.faults is None else draw_attributions(evidence.faults.tally.groups)
        ),
        refused=findings.refused.most_common(),
        nearest_hand=Unit.LENGTH.margin_text(evidence.nearest_hand_m)
        if isfinite(evidence.nearest_hand_m)
        else "",
        not_found_words=not_found_words(findings),
        share=share_words,
        minus=with_minus,
        draws=DRAWS,
        most_open=MOST_OPEN,
        searched=evidence.searched,
        is_measured=evidence.searched is KINEMATIC,
        confirming=" and ".join(evidence.confirmed_in) or REFERENCE,
        measured=REFERENCE,
    )


def write_search_page(path: Path, evidence: SearchEvidence) -> None:
    """Write the page of a search; raise OutputError if the file cannot be written."""
    write_text(path, render(evidence))


def write_coverage(path: Path, evidence: SearchEvidence) -> None:
    """Write the coverage of a search as an SVG file; raise OutputError if the file cannot be written."""
    write_text(path, standalone(map_of(evidence), style=asset("report.css")))


def map_of(evidence: SearchEvidence) -> str:
    """Return the coverage as an ``<svg>`` element, for the page and for a separate file."""
    counts, title = evidence.violations.counts, f"Coverage of {evidence.space}"
    return coverage_map(evidence.coverage, counts, prefix="coverage-", title=title)


def _claim_line(findings: Findings, claim: int) -> dict[str, str]:
    """Return a claim's table row for one search.

    The row contains the number of violations, the number of the first violating run, and the least margin.
    """
    first, nearest = int(findings.first_violation[claim]), findings.nearest[claim]
    goal = findings.goals[claim]
    least = "\u2013" if nearest is None else with_minus(goal.margin_text(float(nearest.margins[claim])))
    return {
        "violated": f"{findings.violated[claim]:,} of {findings.evidence[claim]:,}",
        "first": f"{first:,}" if first else "\u2013",
        "least": least,
    }


def _group_row(findings: Findings, group: Group) -> tuple[str, str, str, int, int]:
    """Return a group's table row.

    The row contains the sentence, kind, worst margin, number of runs, and the number of the worst run.
    """
    margin = "\u2013"
    if group.claim is not None:
        margin = with_minus(findings.goals[group.claim].margin_text(group.worst_margin()))
    kind = "" if group.claim is None else group.kind
    return findings.sentence_of(group), kind, margin, group.count, group.worst.number


def _section(shown: WrittenCounterexample, number: int, replays: Replays) -> dict[str, Any]:
    """Return the values of a counterexample's section, which include the commands that repeat it."""
    example, evaluation, trace = shown.one, shown.one.evaluation, shown.trace_file
    found_margin = "\u2013"
    if evaluation is not None and example.found_margin is not None:
        found_margin = with_minus(evaluation.unit.margin_text(example.found_margin))
    run = example.run if isinstance(example.run, Trace) else None
    drawn = run if run is not None and len(example.evaluations) == len(run.scenario.claims) else None
    name, widest = f"counterexample-{number}", 0 if drawn is None else widest_view(drawn)
    on_card = _pictures(drawn, example.evaluations, example.complaint, f"card-{number}-")
    return {
        "id": name,
        "shown": shown,
        "runs": sum(group.count for group in shown.groups),
        "run_command": shlex.join(["safety-harness", "run", str(display_path(shown.path))]),
        "replay_command": ""
        if trace is None
        else replay_command(example.shrunk.scenario, trace, made_in=run.provenance.world if run else ""),
        "margin": "\u2013" if evaluation is None else margin_words(evaluation),
        "found_margin": found_margin,
        "parts": [line for each in example.evaluations for line in _part_lines(each, 0)],
        "run": run,
        "card_view": next(iter(on_card["views"][widest:]), ""),
        **_pictures(drawn, example.evaluations, example.complaint, f"{name}-"),
        "replay": drawn
        and replays.arguments(
            JudgedRun(drawn, example.evaluations, "").under_claim(example.complaint.sentence), name
        ),
    }


def _view_of(complaint: Complaint, world: InOneWorld | None, prefix: str) -> dict[str, object]:
    """Return the values that show a finding in one world, both in words and in drawings."""
    run = None if world is None else world.run
    evaluations: tuple[Evaluation, ...] = ()
    verdict, drawn = "inconclusive", None
    if world is None or not isinstance(run, Trace):
        text = f"no run: {described(run)}" if isinstance(run, Exception) else "not run"
    else:
        drawn, evaluations, text = run, world.evaluations, "it does not occur"
        if complaint.claim is not None:
            verdict, text = evaluations[0].verdict.value, margin_words(evaluations[0])
    pictures = _pictures(drawn, evaluations, complaint, prefix, most=2)
    return {"sentence": complaint.sentence, "words": text, "verdict": verdict, "run": drawn, **pictures}


def _pictures(
    run: Trace | None, evaluations: tuple[Evaluation, ...], complaint: Complaint, prefix: str, most: int = 4
) -> dict[str, Any]:
    """Return the first ``most`` drawings of a run, and the moment that they show.

    The values are empty if there is no run.
    """
    if run is None or len(run.ticks) == 0:
        return {"views": (), "moment_time": "", "moment_of": ""}
    judged = JudgedRun(run, evaluations, "").under_claim(complaint.sentence)
    views, moment = path_views(judged, prefix=prefix)[:most], shown_moment(judged)
    if moment is None:
        return {"views": views, "moment_time": "", "moment_of": ""}
    moment_text = "when a hand was nearest"
    if moment.claim is not None:
        moment_text = f"the worst moment of {evaluations[moment.claim].sentence}"
    return {"views": views, "moment_time": f"{moment.time_s:.3f} s", "moment_of": moment_text}


def _part_lines(evaluation: Evaluation, depth: int) -> list[dict[str, object]]:
    """Return a table row for an evaluation, and a row for each of its conjuncts.

    ``depth`` is the number of steps from the claim down to the evaluation.
    """
    own: dict[str, object] = {
        "depth": depth,
        "verdict": evaluation.verdict.value,
        "margin": margin_words(evaluation),
        "when": "" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s",
        "sentence": evaluation.sentence,
    }
    return [own, *(line for part in evaluation.parts for line in _part_lines(part, depth + 1))]


def progress_figure(searches: list[Findings], *, prefix: str) -> str:
    """Draw how the least margins decreased during the search.

    The result is an ``<svg>`` element with a panel for each claim. The second search, if any, is the
    baseline. The axis of runs is logarithmic, and a cross marks the first violation. The text is empty if no
    claim has a margin yet. The text is also empty for a search against a reference, which has scores instead
    of margins.
    """
    goals = searches[0].goals
    claims = [k for k in range(len(goals)) if any(findings.improvements[k] for findings in searches)]
    if not claims or goals[0].against:
        return ""
    height = TOP_PX + len(claims) * (PANEL_PX + GAP_PX)
    picture = Picture(WIDTH_PX, height)
    for row, claim in enumerate(claims):
        top = TOP_PX + row * (PANEL_PX + GAP_PX)
        axes = picture.axes(LEFT_PX, top, WIDTH_PX - LEFT_PX - RIGHT_PX, PANEL_PX)
        for findings, ink, dashes in zip(searches, INKS, DASHES, strict=False):
            _curve(axes, findings, claim, ink, dashes)
        _decorate(axes, searches, claim)
    names = " and ".join(findings.searcher for findings in searches)
    return picture.svg(
        prefix=prefix,
        title="Least margin so far, over the runs",
        description=f"One panel for each claim, searched by {names}; the table has the numbers.",
    )


def _curve(axes: Axes, findings: Findings, claim: int, ink: Ink, dashes: tuple[float, ...]) -> None:
    steps = findings.improvements[claim]
    if not steps:
        return
    per_si = findings.goals[claim].unit.per_si
    runs = [run for run, _ in steps] + [findings.tried]
    margins = [margin * per_si for _, margin in steps]
    axes.line(*stairs(runs, [*margins, margins[-1]]), ink, width=1.6, dashes=dashes)
    first = int(findings.first_violation[claim])
    if first:
        margin = next(margin for run, margin in reversed(steps) if run <= first) * per_si
        axes.marks([first], [margin], "X", 8.0, fill=ink)


def _decorate(axes: Axes, searches: list[Findings], claim: int) -> None:
    goal = searches[0].goals[claim]
    most = max(2, *(findings.tried for findings in searches))
    axes.x.log = True
    axes.x.show(1.0, most)
    axes.x.ticks = [(10**k, f"{10**k:,}") for k in range(12) if 10**k <= most]
    axes.x.label = "runs"
    axes.hline(0.0, Ink.LIMIT, width=1.2, dashes=(4, 3))
    axes.y.margin, axes.y.grid = 0.12, True
    axes.y.label = f"margin, {goal.unit.symbol}" if goal.unit.symbol else "margin"
    axes.title(plain(f"{claim + 1}  {goal.sentence}", longest=110), bold=False)
