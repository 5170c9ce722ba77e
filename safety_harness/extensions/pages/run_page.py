"""Write one self-contained HTML file about one or several runs.

The template inserts values without further computation.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import refuse_other_type
from safety_harness.base.proportions import share_words
from safety_harness.base.whole_file import write_whole
from safety_harness.claims.properties.catalogue import entry_claimed
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.extensions.pages.page_parts import MOST_OPEN, added_sections, render_page
from safety_harness.extensions.pages.path_views import MOST_NUMBERS, path_views, shown_moment, widest_view
from safety_harness.extensions.pages.replay import Replays
from safety_harness.extensions.pages.timeline import thinning, timeline
from safety_harness.report.decisions import (
    MOST_DECISION_ROWS,
    DecisionTally,
    are_counted,
    avoiders,
    computing_time_lines,
    decision_rows,
    failed_checks,
    fault_notes,
    latency_words,
    overruling_lines,
    overruling_of_each,
    tested_words,
)
from safety_harness.report.evidence import (
    AboutRuns,
    JudgedRun,
    answer,
    basis_of,
    notes_of,
    tallies,
    with_defaults,
)
from safety_harness.report.knowledge import measured_rows
from safety_harness.report.machine import refused_data
from safety_harness.report.shielding import shield_lines, slowings
from safety_harness.report.verdict_lines import nearest_hand_words
from safety_harness.report.words import (
    MODE_WORDS,
    changes,
    count_words,
    flag_words,
    margin_words,
    with_minus,
)
from safety_harness.scenario.faults import fault_words
from safety_harness.scenario.files import as_path
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.limiting import limit_lines
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured, decided, measured

__all__ = ["write_report"]

Row = dict[str, Any]
MOST_SLOWINGS = 20  # stretches in a table; the report for programs lists all
MOST_IN_FULL = 20  # runs that are drawn, so that a page of a thousand runs opens at once
MOST_TOLD = 20  # unexpected verdicts or cut-short runs at the top of the page; the table lists all
MOST_AT_ONCE = 100  # rows of verdicts, or runs not drawn, that a browser reads while it opens a page


def write_report(
    path: str | Path,
    runs: Sequence[JudgedRun],
    *,
    title: str,
    command: str,
    interrupted: bool,
    generated_at: datetime,
    **facts: Unpack[AboutRuns],
) -> None:
    """Write the report on ``runs`` to ``path``, either completely or not at all.

    The page needs no network.

    Args:
        path: The file to write. The function creates missing folders.
        runs: The judged runs.
        title: The heading of the page.
        command: The command line that wrote the report.
        interrupted: Whether planned runs are missing.
        generated_at: The time that the page shows.
        facts: The optional facts ``coverage``, ``skipped``, ``refused``, ``against`` and ``repeated``, as
            ``AboutRuns`` defines them.

    Raises:
        InputError: The path or a run has the wrong type.
        OSError: The file cannot be written.

    """
    path = as_path(path, "write_report(path)")
    for run in runs:
        refuse_other_type("write_report(runs)", run, JudgedRun)
    page = render(
        runs, title=title, command=command, interrupted=interrupted, generated_at=generated_at, **facts
    )
    write_whole(path, page)


def render(
    runs: Sequence[JudgedRun],
    *,
    title: str,
    command: str,
    interrupted: bool,
    generated_at: datetime,
    **given_facts: Unpack[AboutRuns],
) -> str:
    """Return the page as text.

    The same arguments always result in the same bytes.
    """
    facts = with_defaults(given_facts)
    summary = _summary(runs, whole=not (interrupted or facts["skipped"] or facts["refused"]))
    summary["interrupted"] = interrupted
    fallback = summary["decisions"].fallback
    replays = Replays()
    sections = [
        _section(run, number, replays if full else None)
        for number, (run, full) in enumerate(zip(runs, _in_full(runs), strict=True), start=1)
    ]
    return render_page(
        "report.html.j2",
        title=f"{title}; {fallback}" if fallback else title,
        made=(generated_at, command),
        summary=summary,
        replays=True,
        sections=sections,
        worst=_worst(sections),
        unlike=[
            (section, row) for section in sections for row in section["claims"] if not row["as_expected"]
        ],
        most_told=MOST_TOLD,
        tabled=_tabled(sections),
        parted=_parted(sections),
        most_full=MOST_IN_FULL,
        most_open=MOST_OPEN,
        coverage=tallies(runs) if facts["coverage"] is None else facts["coverage"],
        basis=basis_of(runs, facts["coverage"]),
        skipped=facts["skipped"],
        refused=refused_data(facts["refused"]),
        against=facts["against"],
        repeated=facts["repeated"],
        most_decisions=MOST_DECISION_ROWS,
        share=share_words,
        count=count_words,
        margin=margin_words,
        minus=with_minus,
        most_numbers=MOST_NUMBERS,
    )


def _worst(sections: Sequence[Row]) -> Row | None:
    """Return the worst violation among the drawn runs, and a picture of the moment of this violation.

    An unexpected violation ranks before an expected violation.
    """
    violated = [
        ((row["as_expected"], section["run"].shown_claim() != row["number"] - 1), section, row)
        for section in sections
        for row in section["claims"]
        if section.get("views") and row["found"].verdict is Verdict.VIOLATED
    ]
    if not violated:
        return None
    _, section, row = min(violated, key=lambda ranked: ranked[0])
    run = section["run"].under(row["claim"].sentence)
    view = path_views(run, prefix="worst-")[widest_view(run.trace)]
    return {"section": section, "row": row, "view": view, "nearest": nearest_hand_words(run.trace)}


def _summary(runs: Sequence[JudgedRun], *, whole: bool) -> Row:
    """Return the counts over all runs for the top of the page.

    ``whole`` is True if no planned run is missing.
    """
    traces = [run.trace for run in runs]
    summary: Row = {
        "runs": len(runs),
        "claims": sum(len(run.as_expected) for run in runs),
        **{verdict.value: sum(run.count(verdict) for run in runs) for verdict in Verdict},
        "differing": sum(run.as_expected.count(False) for run in runs),
        "cut_short": sum(not run.trace.complete for run in runs),
        "without_claims": sum(not run.trace.scenario.claims for run in runs),
        "tested": tested_words(traces),
        "avoiders": avoiders(traces),  # name, runs
        "recorded": any(trace.known.recorded for trace in traces),
        "computing_time": computing_time_lines(traces),
        "shield": shield_lines(traces),
        "limits": limit_lines(traces),
        "overruling": overruling_lines(overruling_of_each(traces)),
        "uncounted": sum(not are_counted(trace) for trace in traces),
        "unmeasured": sum(
            bool(evaluation.unmeasured) for run in runs for _, evaluation in run.judged_claims()
        ),
        "decisions": DecisionTally.from_traces(traces),
    }
    whole = whole and not (summary["cut_short"] or summary["without_claims"])
    fine = whole and not (summary["violated"] or summary["inconclusive"])
    decided = summary["holds"] or summary["violated"]
    tone = "fine" if fine else "plain" if whole and decided else "doubt"
    return summary | {"answer": answer(runs), "doubt": _doubt(summary), "tone": tone}


def _doubt(summary: Row) -> str:
    """Return a remark that inconclusive claims are no evidence.

    The text is empty if no claim is inconclusive.
    """
    if not summary["inconclusive"]:
        return ""
    unmeasured = summary["unmeasured"]
    lacking = f" For {count_words(unmeasured, 'claim', 'claims')}, some inputs were not measured."
    return " An inconclusive claim is no evidence of safety, even if its file expects it." + (
        lacking if unmeasured else ""
    )


def _in_full(runs: Sequence[JudgedRun]) -> list[bool]:
    """Decide which runs the report draws, and return a truth value for each run.

    Runs with unexpected results have priority, then the worst run of each claim, then violations.
    """
    margins: dict[str, tuple[float, int]] = {}
    for k, run in enumerate(runs):
        for claim, evaluation in run.judged_claims():
            if evaluation.margin is not None:
                margins[claim.sentence] = min(
                    (float(evaluation.margin), k), margins.get(claim.sentence, (np.inf, k))
                )
    worst = {k for _, k in margins.values()}

    def matters(k: int) -> tuple[bool, ...]:
        run = runs[k]
        return (
            run.trace.complete and all(run.as_expected),
            k not in worst,
            not run.count(Verdict.VIOLATED),
        )

    drawn = set(sorted(range(len(runs)), key=matters)[:MOST_IN_FULL])
    return [k in drawn for k in range(len(runs))]


def _tabled(sections: Sequence[Row]) -> list[tuple[bool, Sequence[Row]]]:
    """Divide the sections for the table of verdicts into a first part and the remaining part.

    Each part is a pair (later, sections), where ``later`` states whether the browser reads the part later.
    """
    rows = np.cumsum([len(section["claims"]) for section in sections])
    first = int(np.searchsorted(rows, MOST_AT_ONCE)) + 1
    return [(later, part) for later, part in ((False, sections[:first]), (True, sections[first:])) if part]


def _parted(sections: Sequence[Row]) -> list[tuple[bool, Sequence[Row]]]:
    """Divide the sections into parts, and keep their order.

    Each part is a pair (later, sections), where ``later`` states whether the browser reads the part later.
    The browser reads the drawn runs at once.
    """

    def part(section: Row) -> tuple[int, bool]:
        hundred = section["number"] // MOST_AT_ONCE
        return hundred, hundred > 0 and not section["full"]

    return [(later, list(group)) for (_, later), group in groupby(sections, part)]


def _section(run: JudgedRun, number: int, replays: Replays | None) -> Row:
    """Return the values of a run's section.

    If the report draws the run, ``replays`` has the page's replays. Otherwise, ``replays`` is None.
    """
    run = replace(run, trace=as_measured(run.trace))
    counts = [f"{run.count(verdict)} {verdict.value}" for verdict in Verdict if run.count(verdict)]
    section = {
        "id": f"run-{number}",
        "number": number,
        "run": run,
        "full": replays is not None,
        "outcome": ", ".join(counts),
        "claims": claim_rows(run),
        "file": file_name(run),
        "trace": "" if run.trace_file is None else shlex.quote(str(run.trace_file)),
        "trace_name": "" if run.trace_file is None else shlex.quote(run.trace_file.stem),
        "tally": DecisionTally.from_traces([run.trace]),
        "measured": measured_rows(run.trace),
        "notes": notes(run),
    }
    return section if replays is None else section | _drawn(run, f"run-{number}", replays)


def _drawn(run: JudgedRun, section: str, replays: Replays) -> Row:
    """Return the additional values of a run that the report draws."""
    trace = run.trace
    drawn = len(trace.ticks) > 0
    moment = shown_moment(run)
    modes = {mode_name: trace.ticks["mode"] == mode for mode, mode_name in MODE_WORDS.items()}
    limits = {flag_words(flag): (trace.ticks["limits"] & flag.value) != 0 for flag in Limit if flag}
    return {
        "views": path_views(run, prefix=f"{section}-") if drawn else (),
        "replay": replays.arguments(run, section),
        "timeline": Markup(timeline(run, prefix=f"{section}-time-") if drawn else ""),
        "moment_time": f"{moment.time_s:.3f} s" if moment else "",
        "moment_claim": moment.claim + 1 if moment and moment.claim is not None else None,  # counted from 1
        "thinned": thinning(trace),
        "decisions": decision_rows(trace),
        "failed_checks": failed_checks(trace),  # name, meaning
        "faults": fault_notes(trace),
        "latency": latency_words(trace),
        "decided": decided(trace, "tick", "time_s"),
        "counted": are_counted(trace),
        "kind": tested_words([trace]),
        "limits": _ticks_rows(trace, "limits", limits),
        "slowings": [
            (
                f"{slow.from_s:.3f}",
                f"{slow.to_s:.3f}",
                slow.part,
                slow.hand,
                f"{100.0 * slow.least_scale:.0f} %",
            )
            for slow in slowings(trace)[:MOST_SLOWINGS]
        ],
        "modes": _ticks_rows(trace, "mode", modes),
        "measured_ticks": {name: int(measured(trace, name).sum()) for name in ("mode", "limits")},
        "changes": changes(run.trace.scenario),
        "text": write_scenario(trace.scenario),
        "added": added_sections("run", run, f"{section}-"),
    }


def claim_rows(run: JudgedRun) -> list[Row]:
    """Return one row of the table of verdicts for each claim of ``run``."""
    judged = zip(run.judged_claims(), run.as_expected, strict=True)
    return [
        {
            "number": number,
            "claim": claim,
            "found": evaluation,
            "as_expected": expected,
            "margin": margin_words(evaluation),
            "margin_sort": "" if evaluation.margin is None else f"{float(evaluation.margin)!r}",
            "worst": "\u2013" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s",
            "worst_sort": "" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s!r}",
            "terms": _terms_of_separation(run.trace, claim) if evaluation.margin is not None else [],
        }
        for number, ((claim, evaluation), expected) in enumerate(judged, start=1)
    ]


def _terms_of_separation(trace: Trace, claim: Claim) -> list[tuple[str, str, str]]:
    """Return the terms of the protective separation that a claim requires.

    Each term has a symbol, a length and an assumption. The list is empty for a claim without such terms.
    """
    meant = entry_claimed(claim.sentence)
    if meant is None or not isinstance(meant[0].prop, ProtectiveSeparation):
        return []
    claimed = property_of(claim, trace.scenario)
    worst = claimed.worst(trace) if isinstance(claimed, ProtectiveSeparation) else None
    terms = () if worst is None else worst.terms
    return [(term.symbol, f"{term.length_m * 1e3:.1f} mm", term.assumption) for term in terms]


def file_name(run: JudgedRun) -> str:
    """Return the name of the scenario's file.

    If the file has a matrix, add the scenario's combination to the name. If the scenario has no file, return
    the scenario's name.
    """
    scenario = run.trace.scenario
    if scenario.file is None:
        return scenario.name
    label = scenario.name.removeprefix(scenario.file.stem)  # the row of a matrix
    return scenario.file.name + (f" {label}" if label.startswith("[") else "")


def _ticks_rows(trace: Trace, name: str, masks: dict[str, NDArray[np.bool_]]) -> list[Row]:
    """Return a row for each mask that is true at some tick at which ``name`` was measured.

    A row has the number of these ticks, their percentage, and the first time.
    """
    there = measured(trace, name)
    return [
        {
            "name": name,
            "ticks": int(mask.sum()),
            "share": share_words(int(mask.sum()), int(there.sum())),
            "first": f"{trace.time_s[int(np.argmax(mask))]:.3f} s",
        }
        for name, mask in ((name, mask & there) for name, mask in masks.items())
        if mask.any()
    ]


def notes(run: JudgedRun) -> list[str]:
    """Return all notes for the reader: the notes of the run, notes on recordings, and notes on faults."""
    all_notes = dict.fromkeys((*run.notes, *notes_of(run.trace.scenario)))  # commands note the recordings too
    return [*all_notes, *acted_faults(run.trace)]


def acted_faults(trace: Trace) -> list[str]:
    """Return a sentence on each fault of the scenario, with the number of ticks at which it was active."""
    faults = []
    for k, fault in enumerate(trace.scenario.faults):
        mask = (trace.ticks["faults"] >> k & 1) != 0
        if not measured(trace, "faults").all():
            faults.append(f"Fault: {fault_words(fault)}. At some ticks, its activity was not measured.")
            continue
        ticks = int(np.count_nonzero(mask))
        when = f"first at {trace.time_s[int(np.argmax(mask))]:.3f} s" if ticks else "so it changed nothing"
        faults.append(
            f"Fault: {fault_words(fault)}. It acted on {count_words(ticks, 'tick', 'ticks')}, {when}."
        )
    return faults
