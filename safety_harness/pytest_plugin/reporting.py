"""``--safety-report FILE``: the report of ``safety-harness run`` on the runs that tests judged.

The process that made a run writes its trace to the folder FILE-traces; the session that gathers the
results reads it there.  Of a test that draws its scenarios the worst run of each claim is shown.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from safety_harness.admission.avoiders import replay_command
from safety_harness.exceptions import InputError
from safety_harness.properties.answered import AvoiderAnswered, with_expectation
from safety_harness.properties.base import Evaluation
from safety_harness.properties.tally import ClaimTally
from safety_harness.pytest_plugin.plugin import explained
from safety_harness.pytest_plugin.sending import Payload, packed, unpacked
from safety_harness.report.evidence import JudgedRun, notes_of
from safety_harness.report.html import write_report
from safety_harness.report.machine import write_json
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.testing.session import TestRun, session
from safety_harness.testing.simulating import digest_of
from safety_harness.trace.store import load_trace, save_trace

TITLE = "Safety properties of a hand-avoiding robot arm"


def save_runs(test: TestRun, report: Path) -> list[list[Any]]:
    """Write the traces of ``test``: [file, expected verdict, evaluation] of each claim, as plain data.

    Raises OSError.
    """
    found = []
    folder = report.with_name(f"{report.stem}-traces")
    for sentence, trace in test.traces.items():
        scenario, worst = trace.scenario, test.worst[sentence]
        file = folder / f"{scenario.name.partition('#')[0]}-{digest_of(scenario)[:12]}.trace"
        if file not in session().saved:  # what an earlier session wrote may be of other code
            folder.mkdir(parents=True, exist_ok=True)
            save_trace(trace, file)
            session().saved.add(file)
        found.append([str(file), worst.expected.value, packed(worst.evaluation)])
    return found


@dataclass(eq=False)
class _Claims:
    """What several tests said of one trace."""

    claims: list[Claim] = field(default_factory=list)
    evaluations: list[Evaluation] = field(default_factory=list)
    tests: list[str] = field(default_factory=list)


def write_reports(
    file: Path, sent: Sequence[Payload], coverage: Sequence[ClaimTally], *, config: pytest.Config, whole: bool
) -> str:
    """Write ``file`` and its JSON; why it cannot be done, or nothing.  ``whole``: no test is missing."""
    try:
        runs = list(_runs(sent))
        command = shlex.join(["pytest", *config.invocation_params.args])
        write_report(
            file,
            runs,
            title=TITLE,
            command=command,
            interrupted=not whole,
            generated_at=datetime.now(UTC),
            coverage=coverage,
        )
        write_json(file.with_suffix(".json"), runs, interrupted=not whole, coverage=coverage)
    except OSError as error:
        return f"no report: {error}"
    except InputError as error:
        return f"no report: {explained(error)}"
    return ""


def _runs(sent: Sequence[Payload]) -> Iterator[JudgedRun]:
    """One judged run for each trace, with all the claims that were made of it."""
    by_file: dict[str, _Claims] = {}
    for one in sent:
        for name, expected, evaluation in one["traces"]:
            of_trace = by_file.setdefault(name, _Claims())
            if one["test"] not in of_trace.tests:
                of_trace.tests.append(one["test"])
            judged = unpacked(evaluation)
            if judged.sentence not in [claim.sentence for claim in of_trace.claims]:
                of_trace.claims.append(Claim(sentence=judged.sentence, expected=Verdict(expected)))
                of_trace.evaluations.append(judged)
    for name, of_trace in by_file.items():
        trace = load_trace(Path(name))
        claims = with_expectation(tuple(of_trace.claims), trace.scenario)
        more = [AvoiderAnswered().evaluate(trace) for _ in claims[len(of_trace.claims) :]]
        scenario = replace(trace.scenario, claims=claims)
        yield JudgedRun(
            trace=replace(trace, scenario=scenario),
            evaluations=(*of_trace.evaluations, *more),
            replay_command=replay_command(scenario, Path(name)),
            trace_file=Path(name),
            notes=(*notes_of(scenario), *(f"judged by {test}" for test in of_trace.tests)),
        )
