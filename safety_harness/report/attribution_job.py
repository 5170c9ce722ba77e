"""Attribute violations to ingredients: ``safety_harness.attribute``, its result, and the result's picture."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import one_of, with_avoider, with_program
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, Place, ScenarioError, described
from safety_harness.base.input_errors import InputErrors, each_once, usable
from safety_harness.base.output import AS_EXPECTED, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.shipped.contents import located
from safety_harness.base.whole_file import write_text
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.report.page_parts import asset
from safety_harness.report.run_result import RunResult
from safety_harness.report.search_attribution import confirming_line, draw_attributions
from safety_harness.report.shielding import slowings
from safety_harness.report.svg import standalone
from safety_harness.scenario.expand import gather
from safety_harness.scenario.files import as_path
from safety_harness.scenario.kinds import FileKind, command_for, kind_of
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.search.attribution.attribute import Attribution, AttributionAnswer, confirmed
from safety_harness.search.attribution.attribute import attribute as attribute_run
from safety_harness.search.attribution.shielding import attribute_shield
from safety_harness.search.attribution.tally import AttributionTally
from safety_harness.trace.store import load_trace
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import refuse_not_simulated

DATA, PICTURE = "attribution.json", "attribution.svg"
TRACE = ".trace"

Attributable = str | Path | Scenario | Trace | RunResult


def attribute(
    runs: Attributable | Iterable[Attributable],
    *,
    avoider: str | None = None,
    controller: str | None = None,
    confirm: bool = False,
    output: Output = QUIET,
) -> AttributionResult:
    """Run each violated run again with one ingredient changed, then two, and say which of them mend it.

    Args:
        runs: One or many of: the result of ``run``, a trace, its file, a scenario, its file, or a folder.
        avoider: The program that a trace was made with, named again, since it is executed.
        controller: Likewise.
        confirm: Run each violation, and what is blamed changed, in PyBullet too.
        output: What hears of the progress.

    Ctrl-C ends it, and the result keeps what was attributed.

    Raises:
        InputErrors: Inputs cannot be used; nothing was run.
        InputError: An option cannot be used, or the world is not installed.

    """
    tested = one_of(avoider, controller)
    if confirm:
        PYBULLET.opener()
    scenarios, errors = _scenarios(runs, tested)
    admitted, refused = usable(scenarios, Admitter().admit)
    if all_refused := each_once([*errors, *refused]):
        for error in all_refused:
            output.explain(error)
        raise InputErrors(all_refused, left=len(admitted))
    found = attribute_all([(one, ()) for one in admitted], len(admitted), "runs", confirm, output)
    if not found.attributions:
        output.say(f"{len(admitted)} runs without a violation: nothing to attribute")
    return found


@dataclass(frozen=True, eq=False, repr=False)
class AttributionResult:
    """What the violations of runs are attributed to.

    Args:
        attributions: One for each violation.
        failed: A run could not be run again.
        interrupted: Ctrl-C ended it.

    """

    attributions: tuple[Attribution, ...]
    failed: bool = False
    interrupted: bool = False

    @property
    def tally(self) -> AttributionTally:
        """The attributions in groups."""
        return AttributionTally.of(self.attributions)

    @property
    def exit_code(self) -> int:
        """The command's exit code."""
        if self.interrupted:
            return INTERRUPTED
        missing = any(one.answer is AttributionAnswer.NOT_ATTRIBUTED for one in self.attributions)
        return DIFFERS if missing or self.failed else AS_EXPECTED

    def __repr__(self) -> str:
        words = self.tally.words if self.attributions else "nothing to attribute"
        return f"<violations in {KINEMATIC}, {words}>"

    def data(self) -> dict[str, object]:
        """Return what attribution.json holds."""
        return self.tally.as_json()

    def write(self, folder: str | Path) -> AttributionResult:
        """Write attribution.json and attribution.svg; OutputError if the folder cannot be written."""
        write_text(Path(folder) / DATA, json.dumps(self.data(), indent=1) + "\n")
        drawn = standalone(draw_attributions(self.tally.groups), style=asset("report.css"))
        write_text(Path(folder) / PICTURE, drawn)
        return self


def attribute_all(
    runs: Iterable[tuple[Admitted, Sequence[Claim]]], count: int, unit: str, confirm: bool, output: Output
) -> AttributionResult:
    """Attribute and print the violations of runs until Ctrl-C: of these claims, or of all of a run's own."""
    found: list[Attribution] = []
    failed = interrupted = False
    try:
        with output.counting(count, unit) as show:
            show(0)
            for number, (admitted, claims) in enumerate(runs, start=1):
                try:
                    attributions, shield = attribute_run(admitted, claims), attribute_shield(admitted)
                except Exception as error:  # one run's failure must not cost the others' answers
                    failed = True
                    output.say(f"error: {admitted.scenario.name} could not be run again: {described(error)}")
                else:
                    if shield is not None:
                        output.result(f"{admitted.scenario.name}: {shield.words}")
                        output.result(*(f"    {one}" for one in slowings(shield.trace)))
                    for one in attributions:
                        found.append(one)
                        for line in _lines(one, admitted if confirm else None):
                            output.result(line)
                show(number)
    except KeyboardInterrupt:
        interrupted = True
    return AttributionResult(tuple(found), failed, interrupted)


def _lines(one: Attribution, confirming: Admitted | None) -> Iterator[str]:
    """Yield what is said of one violation, and what PyBullet says of the run ``confirming`` it."""
    yield f"{one.scenario}: {one.claim.sentence}: {one.unit.margin_text(one.margin)}: {one.words}"
    if confirming is not None and one.answer is not AttributionAnswer.NOT_ATTRIBUTED:
        yield from (f"    {confirming_line(again, one)}" for again in confirmed(confirming, one))


def _scenarios(
    runs: Attributable | Iterable[Attributable], avoider: str | None
) -> tuple[list[Scenario], list[InputError]]:
    """Return what is to be run again: of a trace its scenario, which claims what it violates."""
    given = list(runs) if isinstance(runs, Iterable) and not isinstance(runs, str) else [runs]
    kept: list[tuple[Trace, Path | None]] = []
    asked: list[Scenario] = []
    paths: list[Path] = []
    for one in given:
        if isinstance(one, RunResult):
            kept += [(run.trace, run.trace_file) for run in one.runs]
        elif isinstance(one, Trace):
            kept.append((one, None))
        elif isinstance(one, Scenario):
            asked.append(one)
        else:
            paths.append(located(one) if isinstance(one, Path) else as_path(one, "attribute(runs)"))
    traces = [path for path in paths if path.suffix == TRACE]
    files = [path for path in paths if path.suffix != TRACE and not path.is_dir()]
    errors: list[InputError] = []
    for folder in (path for path in paths if path.is_dir()):
        own, stored = sorted(folder.glob("*.yaml")), sorted(folder.rglob(f"*{TRACE}"))
        files += own
        traces += [path for path in stored if path.with_suffix(".yaml") not in own]
        if not (own or stored):
            expected = f"a folder with scenario files (*.yaml) or traces (*{TRACE})"
            kind = kind_of(folder) or FileKind.FOLDER
            got, hint = f"{kind.words} without any", command_for(folder, kind)
            errors.append(ScenarioError(place=Place(file=folder), expected=expected, got=got, hint=hint))
    gathered = gather(files) if files else None
    named = [*(gathered.scenarios if gathered else ()), *asked]
    chosen, refused = usable(named, lambda one: one if avoider is None else with_avoider(one, avoider))
    violated, unread = usable(traces, lambda path: _violated(load_trace(path), path, avoider))
    more, unusable = usable(kept, lambda one: _violated(*one, avoider))
    violated, unread = [*violated, *more], [*unread, *unusable]
    errors += [*(gathered.errors if gathered else ()), *refused, *unread]
    return [*chosen, *(one for one in violated if one.claims)], errors


def _violated(trace: Trace, path: Path | None, avoider: str | None) -> Scenario:
    """Return the scenario of a trace, with the claims that the trace violates alone."""
    refuse_not_simulated(trace, path)
    scenario = with_program(trace.scenario, avoider, path, verb="attribute")
    evaluations = judge(trace, file=path)
    claims = tuple(
        replace(claim, expected=Verdict.VIOLATED)
        for claim, evaluation in zip(trace.scenario.claims, evaluations, strict=True)
        if evaluation.verdict is Verdict.VIOLATED
    )
    return replace(scenario, claims=claims)
