"""Write a page's evidence for other programs, as one JSON file about one or several runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, Unpack

from safety_harness.base.exceptions import InputError
from safety_harness.base.whole_file import write_whole
from safety_harness.claims.properties.answered import AvoiderAnswered
from safety_harness.claims.properties.base import SI_UNITS, Evaluation
from safety_harness.claims.properties.tally import ClaimTally
from safety_harness.report.decisions import (
    DecisionTally,
    are_counted,
    asks_of_hands,
    computing_time_lines,
    overruling_of_each,
    refused_for_possible,
)
from safety_harness.report.evidence import AboutRuns, JudgedRun, basis_of, tallies, with_defaults
from safety_harness.report.knowledge import known_data
from safety_harness.report.shielding import shield_data
from safety_harness.scenario.files import display_path
from safety_harness.trace.limiting import limited_data
from safety_harness.trace.overruling import Overruling, is_measured

FORMAT = "safety-harness report 1"
COUNTED = ("runs", "exercised", "occasions", "holds", "violated", "inconclusive", "unmeasured")


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write the result of ``report_data`` to ``path`` completely or not at all.

    Raise OSError if the writing fails.
    """
    write_whole(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def report_data(
    runs: Sequence[JudgedRun], *, interrupted: bool, **facts: Unpack[AboutRuns]
) -> dict[str, Any]:
    """Return the results of ``runs`` as an object that can be written as JSON.

    The object has these fields:

    - ``format``, ``made_at`` (ISO 8601), and ``interrupted`` (whether planned runs are missing);
    - ``basis``: a sentence that states what the verdicts are based on;
    - ``overruling``: for each avoider, the number of overruled proposals, the reasons and the replacements;
    - ``runs``: the runs in the form that ``run_data`` describes;
    - ``coverage``: for each claim, how often the runs tested it;
    - ``skipped``, ``refused`` and ``against``: the facts of the same names in ``AboutRuns``;
    - ``repeatability``: the answers of a second avoider to the same questions, or null.

    Margins are in SI units with full precision. A missing margin is null. If a margin is not finite, it is
    written as the text "inf", "-inf" or "nan", because JSON has no such numbers.

    Args:
        runs: The judged runs.
        interrupted: Whether planned runs are missing.
        facts: The optional facts that ``AboutRuns`` defines: ``coverage``, ``skipped``, ``refused``,
            ``against`` and ``repeated``.

    Raises:
        OSError: A trace file cannot be read.

    """
    given = with_defaults(facts)
    coverage, against, repeated = given["coverage"], given["against"], given["repeated"]
    skipped = given["skipped"]
    return {
        "format": FORMAT,
        "made_at": datetime.now(UTC).isoformat(),
        "interrupted": interrupted,
        "basis": basis_of(runs, coverage),
        "overruling": {
            name: row.named for name, row in overruling_of_each(run.trace for run in runs).items()
        },
        "runs": [run_data(run) for run in runs],
        "coverage": [_coverage(tally) for tally in (tallies(runs) if coverage is None else coverage)],
        "skipped": [
            {"scenario": row.scenario, "avoider": row.avoider, "reason": str(row.error)} for row in skipped
        ],
        "refused": refused_data(given["refused"]),
        "against": None if against is None else against.as_json(),
        "repeatability": None if repeated is None else asdict(repeated),
    }


def refused_data(refused: Sequence[InputError]) -> list[dict[str, Any]]:
    """For each input that cannot be used, return its place and the reason."""
    return [
        {
            "file": None if error.place.file is None else str(display_path(error.place.file)),
            "line": error.place.line,
            "field": error.place.field,
            "reason": f"expected {error.expected}; got {error.got}",
            "hint": error.hint or None,
        }
        for error in refused
    ]


def run_data(run: JudgedRun) -> dict[str, Any]:
    """Return one run as JSON.

    ``system`` lists the parts of the tested system, and an absent part is null. ``avoider_answered`` is null
    without an avoider. A claim has ``parts`` if its formula is a conjunction, that is, if it joins formulas
    by "and". ``unmeasured`` lists the columns whose absence makes a claim inconclusive. ``known`` lists the
    columns whose values are not simulated truth. ``decisions`` and ``overruling`` are null if the trace has
    no measurements of them. ``trace_sha256`` is the hash that the trace file has at present. ``limits``
    states how many commands each limit changed.
    """
    trace, scenario, file = run.trace, run.trace.scenario, run.trace_file
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "file": str(display_path(scenario.file)) if scenario.file else None,
        "seed": scenario.seed,
        "system": trace.system.as_dict,
        "world": trace.provenance.world,
        "package_version": trace.provenance.package_version,
        "source_hash": trace.provenance.source_hash,
        "complete": trace.complete,
        "ended": trace.ended,
        "known": known_data(trace),
        "trace_file": str(display_path(file)) if file else None,
        "trace_sha256": hashlib.sha256(file.read_bytes()).hexdigest() if file else None,
        "decisions": asdict(DecisionTally.from_traces([trace])) if are_counted(trace) else None,
        "overruling": Overruling.from_traces([trace]).named if is_measured(trace) else None,
        "avoider_answered": None if scenario.driven else _outcome(AvoiderAnswered().evaluate(trace)),
        "computing_time": computing_time_lines([trace]),
        "limits": limited_data(trace),
        **({"refused_for_possible_hands": refused_for_possible(trace)} if asks_of_hands(trace) else {}),
        **({} if scenario.shield is None else {"shield": shield_data(trace)}),
        "claims": [
            {
                "claim": claim.sentence,
                "expected": claim.expected.value,
                **_outcome(evaluation),
                "parts": [{"claim": part.sentence, **_outcome(part)} for part in evaluation.parts],
            }
            for claim, evaluation in run.judged_claims()
        ],
    }


def _outcome(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "verdict": evaluation.verdict.value,
        "margin_si": _number(evaluation.margin),
        "unit": SI_UNITS[evaluation.unit],
        "worst_time_s": _number(evaluation.worst_time_s),
        "reason": evaluation.reason,
        "exercised": evaluation.exercised,
        "unmeasured": list(evaluation.unmeasured),
    }


def _coverage(tally: ClaimTally) -> dict[str, Any]:
    worst = tally.worst
    return {
        "claim": tally.sentence,
        **{name: getattr(tally, name) for name in COUNTED},
        "worst_margin_si": _number(worst.evaluation.margin) if worst else None,
        "worst_scenario": worst.run if worst else None,
        "untested": tally.untested,
        "untested_for": tally.nearest.evaluation.reason if tally.nearest else None,
    }


def _number(value: float | None) -> float | str | None:
    if value is None:
        return None
    return float(value) if isfinite(value) else str(float(value))
