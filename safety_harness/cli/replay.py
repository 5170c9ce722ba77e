"""Define ``safety-harness replay``, which repeats a stored run, and ``judge``, which judges it again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import with_program
from safety_harness.admission.driving import refuse_other_parts
from safety_harness.admission.repeatability import MOST, Repeatability
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InputError, Place, TraceError
from safety_harness.cell.simulation.worlds import KINEMATIC, engine_elsewhere, world_named, world_of_trace
from safety_harness.claims.properties.tally import short_basis
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    document,
    explain_each,
    result,
    say,
)
from safety_harness.cli.progress import TERMINAL, terminal
from safety_harness.cli.run import print_verdicts
from safety_harness.report.evidence import JudgedRun, answer, basis_of
from safety_harness.report.judge_job import A_CLAIM, judged_run, write_judged
from safety_harness.report.knowledge import measured_lines, unmeasured_words
from safety_harness.report.machine import refused_data, run_data
from safety_harness.report.run_job import watching_runs
from safety_harness.report.run_result import report_line
from safety_harness.report.verdict_lines import every_line
from safety_harness.scenario.model import VISUAL_SERVO
from safety_harness.scenario.references import file_and_name
from safety_harness.trace.compare import CLOSE, TraceDifference, first_difference
from safety_harness.trace.store import load_trace
from safety_harness.trace.system import Component
from safety_harness.trace.trace import Provenance, Trace
from safety_harness.trace.unmeasured import refuse_not_simulated


def replay(path: Path, avoider: str | None = None, world: str | None = None, **beside: str | None) -> int:
    """Repeat a recorded run, and print "identical" or the first step that differs.

    Return the exit code. The function also asks a second avoider the same questions, to detect an avoider
    that remembers earlier questions. ``avoider`` and ``world`` are the user's references to the programs of
    the trace, and ``beside`` contains the references to the safety filter and the predictor. The user must
    state them, because a trace from an untrusted source must not decide which program is executed.
    """
    stored = load_trace(path)
    refuse_not_simulated(stored, path)
    made_in = stored.provenance.world
    if world is not None and world_named(world, "--world").name != made_in:
        raise TraceError(place=Place(file=path, field="world"), expected=f"--world {made_in}", got=world)
    entry = world_of_trace(made_in)
    admitted = admit(with_program(stored.scenario, avoider, path, beside=beside))
    _refuse_other(stored, admitted, path)
    refuse_other_parts(stored, admitted.scenario, path)
    with watching_runs([stored.scenario], TERMINAL) as progress:
        progress.begin(0)
        fresh = run_trial(admitted, world=entry, recorded=stored, on_tick=progress.tick)
    if not fresh.complete and stored.complete:
        say(f"{fresh.ended}, after {len(fresh.ticks)} of {len(stored.ticks)} ticks")
        return INTERRUPTED
    repeatability = Repeatability()
    repeatability.add(fresh)
    repeated = repeatability.check(least=MOST)
    difference = first_difference(stored, fresh)
    then, now = stored.provenance, fresh.provenance
    may_differ = _of_earlier_arithmetic(then, now) or engine_elsewhere(then, now)
    # Compare with a tolerance only if the arithmetic or an engine on another machine explains the difference.
    last_bits = difference is not None and may_differ
    deviation = first_difference(stored, fresh, CLOSE) if last_bits else difference
    if deviation is None:
        counted = f"{len(fresh.ticks)} ticks, {len(fresh.decisions)} decisions"
        kind = f"equal to {CLOSE:g}" if last_bits else "identical"
        result(f"{kind}{', but' if repeated.problem else ''}: {stored.scenario.name}, {counted}")
    else:
        result(f"{stored.scenario.name}: {deviation}")
    (result if repeated.problem else say)(repeated.line)
    changed = [] if difference is None else changes(stored, fresh, deviation)
    say(*changed)
    document(
        scenario=stored.scenario.name,
        identical=difference is None,
        difference=None if difference is None else str(difference),
        equal_within=CLOSE if last_bits and deviation is None else None,
        ticks=len(fresh.ticks),
        decisions=len(fresh.decisions),
        repeatability=repeated,
        changes=[line.strip() for line in changed],
    )
    return AS_EXPECTED if deviation is None and not repeated.problem else DIFFERS


def _of_earlier_arithmetic(then: Provenance, now: Provenance) -> bool:
    return then.arithmetic != now.arithmetic and then.source_hash != now.source_hash


def _refuse_other(stored: Trace, admitted: Admitted, path: Path) -> None:
    """Raise TraceError if the controller has another name or file hash than in the trace."""
    then = stored.system.controller
    now = admitted.driver.component if admitted.driver else Component(name=VISUAL_SERVO)
    known = then.sha256 if admitted.driver else ""
    differs = file_and_name(stored.scenario.controller)[1] != file_and_name(admitted.scenario.controller)[1]
    if then.name != now.name or differs or (known and known != now.sha256):
        place = Place(file=path, field="controller")
        raise TraceError(place=place, expected=f"{then}, which drove then", got=_named(now, admitted))


def _named(now: Component, admitted: Admitted) -> str:
    return f"{now}, {admitted.scenario.controller}" if admitted.driver else str(now)


def changes(first: Trace, repeated: Trace, difference: TraceDifference | None) -> list[str]:
    """Return lines on changes since the trace was stored, and on the consequences of these changes.

    The changes concern software, machines and the system under test.

    Args:
        first: The trace that was stored.
        repeated: The trace of the repeated run.
        difference: The first difference between the two traces that exceeds the tolerance for last bits, or
            None.

    """
    stored, now = first.provenance, repeated.provenance
    names = ("package_version", "source_hash", "world", "python", "platform")
    values = ((name, getattr(stored, name), getattr(now, name)) for name in names)
    lines = [f"  {name}: {then} then, {new} now" for name, then, new in values if then != new]
    lines += [f"  {line}" for line in first.system.changes(repeated.system)]
    versions = dict(now.libraries + now.files)
    for name, then in stored.libraries + stored.files:
        if versions.get(name) != then:
            lines.append(f"  {name}: {then} then, {versions.get(name, 'absent')} now")
    same = not lines
    if same:
        lines = ["  the software is the same as when the trace was made"]
    machines = f"{stored.machine or 'not named by the trace'} then, {now.machine} now"
    lines.append(f"  machine: {now.machine if stored.machine == now.machine else machines}")
    if _of_earlier_arithmetic(stored, now):
        lines.append(f"  arithmetic {stored.arithmetic} then, {now.arithmetic} now: last bits differ")
        lines[-1] += f"; not comparable from {difference.what} {difference.index} on" if difference else ""
    elif engine_elsewhere(stored, now):
        lines.append(f"  an engine's last bits may differ between machines: compared to {CLOSE:g}")
    elif same and stored.world == KINEMATIC.name:
        lines.append("  a fault: with the same software this world has the same bits on every machine")
    return lines


def judge_again(
    paths: Sequence[Path],
    sentences: Sequence[str] = (),
    *,
    keep_going: bool = False,
    out: Path | None = None,
    verbose: bool = False,
) -> int:
    """Judge stored traces and logs of cells by the present code, without simulation.

    Return the exit code. ``sentences`` are claims that replace the claims of the files. The expected verdict
    of these claims is "holds". If ``keep_going`` is true, a file that cannot be judged does not stop the
    others. ``out`` is the folder for a report and for the traces of logs.
    """
    runs: list[JudgedRun] = []
    refused: list[InputError] = []
    for path in paths:
        try:
            run = judged_run(path, sentences, out)
            if len(run.evaluations) == 0:  # a run without verdicts is not "as expected"
                raise TraceError(place=Place(file=path, field="claims"), expected=A_CLAIM, got="none")
        except InputError as error:
            if not keep_going:
                raise
            refused.append(error)
            continue
        terminal(verbose).detail(*every_line(run))
        runs.append(run)
    evaluations = [evaluation for run in runs for _, evaluation in run.judged_claims()]
    document(runs=[run_data(run) for run in runs], basis=basis_of(runs), refused=refused_data(refused))
    print_verdicts(runs, verbose)
    for run in runs:
        result(*measured_lines(run.trace))
        say(*(f"note: {run.trace.scenario.name}: {note}" for note in run.notes if run.trace.known.recorded))
    say(*[basis_of(runs) if verbose else short_basis(basis_of(runs))] * bool(runs))
    result(*[answer(runs)] * (len(runs) > 1))
    if out is not None and runs:
        write_judged(runs, refused, out, paths)
        say(report_line(out))
    if unmeasured := unmeasured_words(evaluations):
        say(f"inconclusive of {len(evaluations)} claims: {unmeasured}")
    if refused:
        say(f"{len(explain_each(refused))} mistakes; {len(runs)} of {len(paths)} traces judged")
        return BAD_INPUT
    return AS_EXPECTED if all(run.all_as_expected for run in runs) else DIFFERS
