"""Write the report of ``--safety-report FILE``.

It has the form of the report of ``safety-harness run``, and contains the runs that tests judged. The process
that simulates a run writes its trace to the folder FILE-traces.  The session that gathers the results reads
the trace from there.  If a test draws scenarios, the report shows the worst run for each claim.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.admission.avoiders import replay_command
from safety_harness.base.exceptions import InputError
from safety_harness.claims.properties.answered import AvoiderAnswered, with_expectation
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import ClaimTally
from safety_harness.report.evidence import JudgedRun, notes_of
from safety_harness.report.machine import report_data, write_json
from safety_harness.report.run_result import draw_page
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.testing.plugin.explained import explained
from safety_harness.testing.plugin.payloads import EndedTest
from safety_harness.testing.session import TestRun, session
from safety_harness.testing.simulating import digest_of
from safety_harness.trace.store import load_trace, save_trace

TITLE = "Safety properties of a hand-avoiding robot arm"


def save_runs(test: TestRun, report: Path) -> tuple[tuple[Path, Verdict, Evaluation], ...]:
    """Write the traces of ``test``.

    Return, for each claim, the file of the trace, the expected verdict and the evaluation.

    Raises:
        OSError: a trace cannot be written.

    """
    saved = []
    folder = report.with_name(f"{report.stem}-traces")
    for sentence, trace in test.traces.items():
        scenario, worst = trace.scenario, test.worst[sentence]
        digest = digest_of(scenario)[:12]
        if not trace.known.simulated:  # a log and a run of the same scenario are different traces
            digest += f"-{hashlib.sha256(trace.ticks.tobytes()).hexdigest()[:12]}"
        file = folder / f"{scenario.name.partition('#')[0]}-{digest}.trace"
        if file not in session().saved:  # an earlier session may have written the file with other code
            folder.mkdir(parents=True, exist_ok=True)
            save_trace(trace, file, recordings=session().recordings)
            session().saved.add(file)
        saved.append((file, worst.expected, worst.evaluation))
    return tuple(saved)


def write_reports(
    file: Path, sent: Sequence[EndedTest], coverage: Sequence[ClaimTally], *, command: str, whole: bool
) -> str:
    """Write ``file`` and its JSON file.

    Return an empty text, or the reason if a file cannot be written.

    Args:
        file: the file of the page; the JSON file has the same stem.
        sent: the tests that ended.
        coverage: how often the runs tested each claim.
        command: the command line that the page shows.
        whole: whether every test ended. If this is false, the report says that the session was interrupted.

    """
    try:
        runs = list(_runs(sent))
        draw_page(
            "runs",
            file,
            runs,
            title=TITLE,
            command=command,
            interrupted=not whole,
            generated_at=datetime.now(UTC),
            coverage=coverage,
        )
        write_json(file.with_suffix(".json"), report_data(runs, interrupted=not whole, coverage=coverage))
    except OSError as error:
        return f"no report: {error}"
    except InputError as error:
        return f"no report: {explained(error)}"
    return ""


def _runs(sent: Sequence[EndedTest]) -> Iterator[JudgedRun]:
    """Yield one judged run for each trace, with all claims that tests judged in this run."""
    by_file: dict[Path, list[tuple[str, Verdict, Evaluation]]] = {}
    for ended in sent:
        for file, expected, evaluation in ended.traces:
            by_file.setdefault(file, []).append((ended.run.id, expected, evaluation))
    for file, judgements in by_file.items():
        trace = load_trace(file)
        first: dict[str, tuple[Claim, Evaluation]] = {}  # the first test's judgement of each claim
        for _, expected, evaluation in judgements:
            claim = Claim(sentence=evaluation.sentence, expected=expected)
            first.setdefault(evaluation.sentence, (claim, evaluation))
        claims = with_expectation(tuple(claim for claim, _ in first.values()), trace.scenario)
        more = [AvoiderAnswered().evaluate(trace) for _ in claims[len(first) :]]
        tests = dict.fromkeys(test for test, _, _ in judgements)
        scenario = replace(trace.scenario, claims=claims)
        made_in = trace.provenance.world
        replayed = replay_command(scenario, file, made_in=made_in) if trace.known.simulated else ""
        yield JudgedRun(
            trace=replace(trace, scenario=scenario),
            evaluations=(*(evaluation for _, evaluation in first.values()), *more),
            replay_command=replayed,
            trace_file=file,
            notes=(*notes_of(scenario), *(f"judged by {test}" for test in tests)),
        )
