"""Judge stored traces and logs, without a simulation."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InadmissibleError, InputError, LogError, Place
from safety_harness.claims.properties.answered import with_expectation
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.run_result import TRACES, saved, write_files
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import display_path
from safety_harness.scenario.kinds import is_log, recorded_run
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.units import shown
from safety_harness.trace.store import load_trace

A_CLAIM = "a claim at least, there or as --claim SENTENCE: nothing is judged without"


def claims_of(sentences: Sequence[str]) -> tuple[Claim, ...]:
    """Return the claims for ``sentences``, each with the expected verdict "holds".

    Raise InadmissibleError for a sentence that is no claim.
    """
    place = Place(field="--claim")
    for sentence in sentences:
        if not is_sentence(sentence):
            raise InadmissibleError(place=place, expected=SENTENCE, got=shown(sentence))
    return tuple(Claim(sentence=sentence, expected=Verdict.HOLDS, place=place) for sentence in sentences)


def judged_run(path: Path, sentences: Sequence[str] = (), out: Path | None = None) -> JudgedRun:
    """Judge a stored trace or the log of a real cell.

    Args:
        path: The file of the trace or the log.
        sentences: The claims to judge. If there are no sentences, the claims in the file are judged.
        out: The folder for the trace of a log. If it is None, no trace is written.

    Raises:
        InputError: The file or a claim cannot be used.

    """
    if is_log(path):
        return _of_log(path, claims_of(sentences), out)
    trace = load_trace(path)
    if sentences:
        claims = with_expectation(claims_of(sentences), trace.scenario)
        trace = replace(trace, scenario=replace(trace.scenario, claims=claims))
    return JudgedRun(trace=trace, evaluations=judge(trace, file=path), replay_command="", trace_file=path)


def _of_log(path: Path, claims: Sequence[Claim], out: Path | None) -> JudgedRun:
    recorded = recorded_run(path, claims)
    if not recorded.trace.scenario.claims:
        raise LogError(place=Place(file=path, field="claims"), expected=A_CLAIM, got="none")
    file = None if out is None else saved(recorded.trace, out / TRACES, recorded.recordings)
    return JudgedRun(
        trace=recorded.trace,
        evaluations=judge(recorded.trace, file=path),
        replay_command="",
        trace_file=file,
        notes=recorded.notes,
    )


def write_judged(
    runs: Sequence[JudgedRun], refused: Sequence[InputError], out: Path, paths: Sequence[Path]
) -> None:
    """Write the report of runs that were judged without simulating.

    Raise OutputError if the writing fails.
    """
    arguments = [
        "safety-harness",
        "judge",
        *(str(display_path(path)) for path in paths),
        "--out",
        str(display_path(out)),
    ]
    command, title = shlex.join(arguments), "Judged without simulating"
    write_files(out, runs, title=title, command=command, interrupted=False, refused=refused)
