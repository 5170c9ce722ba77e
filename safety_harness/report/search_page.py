"""One self-contained HTML page about a search for violations, in the style of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from safety_harness.admission.agreement import Agreement
from safety_harness.avoidance.avoider import described
from safety_harness.properties.base import Evaluation
from safety_harness.report.coverage_map import coverage_map
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.page_parts import in_words, render_page
from safety_harness.report.path_artists import Moment
from safety_harness.report.path_views import path_views, shown_moment
from safety_harness.report.search_progress import progress_figure
from safety_harness.report.words import margin_words, share_words, with_minus
from safety_harness.search.confirm import Complaint
from safety_harness.search.counterexample import DRAWS, Counterexample
from safety_harness.search.coverage import Coverage
from safety_harness.search.disagreement import Disagreement, InOneWorld
from safety_harness.search.findings import Findings, Group
from safety_harness.trace.trace import Trace

MOST_GROUPS = 100  # rows of violations that were found
MOST_DRAWN = 8  # disagreements of the worlds of which both runs are shown


@dataclass(frozen=True, kw_only=True)
class ShownCounterexample:
    """A counterexample with its files (names beside the page) and the commands that run it again.

    ``groups`` of runs, which lie apart, shrank to it.
    """

    one: Counterexample
    groups: tuple[Group, ...]
    searcher: str
    file: str
    trace_file: str  # empty where there is no trace
    run_command: str
    replay_command: str
    text: str

    @property
    def runs(self) -> int:
        """How many led to it."""
        return sum(group.count for group in self.groups)


@dataclass(frozen=True, kw_only=True)
class SearchEvidence:
    """Everything that the page shows.

    ``fallback`` says how often the fallback stood in for the avoider, if it did.  ``baseline`` is uniform
    sampling with the same budget, if it was asked for; ``unconfirmed`` are findings
    that PyBullet does not show, ``confirmed`` counts those that it does.
    """

    title: str
    space: str
    avoider: str
    computing_time: str  # what a decision costs in simulated time
    seed: int
    budget: int
    command: str
    generated_at: datetime
    findings: Findings
    fallback: str
    baseline: Findings | None
    coverage: Coverage
    violations: Coverage
    shown: tuple[ShownCounterexample, ...]
    confirmed: int
    unconfirmed: tuple[Disagreement, ...]
    agreement: Agreement
    provenance: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class ClaimLine:
    """A claim in one search: how often and how soon it was violated, and the least margin."""

    violated: str
    first: str
    least: str


@dataclass(frozen=True)
class PartLine:
    """An evaluation or one of its conjuncts, ``depth`` steps below the claim."""

    depth: int
    verdict: str
    margin: str
    when: str
    sentence: str


@dataclass(frozen=True, kw_only=True)
class CounterexampleSection:
    """What the page shows about one counterexample."""

    id: str
    shown: ShownCounterexample
    margin: str
    found_margin: str
    parts: list[PartLine]
    run: Trace | None
    views: tuple[Markup, ...]
    moment_time: str
    moment_of: str


@dataclass(frozen=True, kw_only=True)
class Told:
    """What one of two worlds says of a finding: in words, and drawn from above and from the side."""

    sentence: str
    words: str
    verdict: str
    run: Trace | None
    views: tuple[Markup, ...]
    moment_time: str
    moment_of: str


def render(evidence: SearchEvidence) -> str:
    """The page as text; the same evidence gives the same bytes."""
    findings, baseline = evidence.findings, evidence.baseline
    searches = [findings] if baseline is None else [findings, baseline]
    return render_page(
        "search.html.j2",
        style="search.css",
        e=evidence,
        generated=in_words(evidence.generated_at),
        searches=searches,
        claims=[
            (goal.sentence, [_claim_line(one, k) for one in searches])
            for k, goal in enumerate(findings.goals)
        ],
        always=[g.sentence for k, g in enumerate(findings.goals) if findings.always_violated(k)],
        untested=[
            g.sentence for k, g in enumerate(findings.goals) if findings.tried and not findings.evidence[k]
        ],
        progress=Markup(progress_figure(searches, prefix="progress-")),
        sections=[_section(shown, number) for number, shown in enumerate(evidence.shown, start=1)],
        groups=[
            _group_row(findings, group)
            for claim in (*range(len(findings.goals)), None)
            for group in findings.of_claim(claim)
        ][:MOST_GROUPS],
        unconfirmed=[_group_row(findings, one.group) for one in evidence.unconfirmed],
        apart=[
            [
                _told(one.complaint, run, f"apart-{number}-{world}-")
                for world, run in enumerate((one.searched, one.confirming))
            ]
            for number, one in enumerate(evidence.unconfirmed, start=1)
            if one.searched is not None
        ],
        map=Markup(
            coverage_map(
                evidence.coverage,
                evidence.violations.counts,
                prefix="coverage-",
                title=f"Coverage of {evidence.space}",
            )
        ),
        refused=findings.refused.most_common(),
        share=share_words,
        minus=with_minus,
        draws=DRAWS,
    )


def _claim_line(findings: Findings, claim: int) -> ClaimLine:
    first, near = int(findings.first_violation[claim]), findings.nearest[claim]
    goal = findings.goals[claim]
    return ClaimLine(
        f"{findings.violated[claim]:,} of {findings.evidence[claim]:,}",
        f"{first:,}" if first else "\u2013",
        "\u2013" if near is None else with_minus(goal.margin_text(float(near.margins[claim]))),
    )


def _group_row(findings: Findings, group: Group) -> tuple[str, str, str, int, int]:
    """What is wrong, of which kind, the worst margin, how many runs near it, the worst point's number."""
    margin = "\u2013"
    if group.claim is not None:
        margin = with_minus(findings.goals[group.claim].margin_text(group.worst_margin()))
    kind = "" if group.claim is None else group.kind
    return findings.sentence_of(group), kind, margin, group.count, group.worst.number


def _section(shown: ShownCounterexample, number: int) -> CounterexampleSection:
    one = shown.one
    evaluation = one.evaluation
    margin = "\u2013" if evaluation is None else margin_words(evaluation)
    found = "\u2013"
    if evaluation is not None and one.found_margin is not None:
        found = with_minus(evaluation.unit.margin_text(one.found_margin))
    run = one.run if isinstance(one.run, Trace) else None
    views: tuple[Markup, ...] = ()
    moment: Moment | None = None
    if run is not None and len(run.ticks) and len(one.evaluations) == len(run.scenario.claims):
        judged = JudgedRun(run, one.evaluations, "").under(one.complaint.sentence)
        views, moment = _pictures(judged, f"counterexample-{number}-")
    return CounterexampleSection(
        id=f"counterexample-{number}",
        shown=shown,
        margin=margin,
        found_margin=found,
        parts=[line for each in one.evaluations for line in _part_lines(each, 0)],
        run=run,
        views=views,
        moment_time=_seconds(moment),
        moment_of=_moment_of(moment, one.evaluations),
    )


def _told(complaint: Complaint, world: InOneWorld | None, prefix: str) -> Told:
    run = None if world is None else world.run
    if world is None or not isinstance(run, Trace):
        return Told(
            sentence=complaint.sentence,
            words=f"no run: {described(run)}" if isinstance(run, Exception) else "not run",
            verdict="inconclusive",
            run=None,
            views=(),
            moment_time="",
            moment_of="",
        )
    if complaint.claim is None:
        verdict, words = "inconclusive", "it does not happen"
    else:
        verdict, words = world.evaluations[0].verdict.value, margin_words(world.evaluations[0])
    judged = JudgedRun(run, world.evaluations, "").under(complaint.sentence)
    views, moment = _pictures(judged, prefix) if len(run.ticks) else ((), None)
    return Told(
        sentence=complaint.sentence,
        words=words,
        verdict=verdict,
        run=run,
        views=views[:2],
        moment_time=_seconds(moment),
        moment_of=_moment_of(moment, world.evaluations),
    )


def _pictures(run: JudgedRun, prefix: str) -> tuple[tuple[Markup, ...], Moment | None]:
    views = path_views(run, prefix=prefix)
    drawn = (views.top, views.side, views.top_close, views.side_close)
    return tuple(Markup(view) for view in drawn), shown_moment(run)


def _seconds(moment: Moment | None) -> str:
    return "" if moment is None else f"{moment.time_s:.3f} s"


def _moment_of(moment: Moment | None, evaluations: Sequence[Evaluation]) -> str:
    """What happens at it."""
    if moment is None or moment.claim is None:
        return "" if moment is None else "when a hand was nearest"
    return f"the worst moment of {evaluations[moment.claim].sentence}"


def _part_lines(evaluation: Evaluation, depth: int) -> Sequence[PartLine]:
    when = "" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
    own = PartLine(depth, evaluation.verdict.value, margin_words(evaluation), when, evaluation.sentence)
    return [own, *(line for part in evaluation.parts for line in _part_lines(part, depth + 1))]
