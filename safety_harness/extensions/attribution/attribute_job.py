"""Provide ``safety_harness.attribute``, which attributes violations to ingredients, and draw its results."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import one_of, with_avoider, with_program
from safety_harness.admission.driving import refuse_other_parts
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, Place, ScenarioError, described
from safety_harness.base.input_errors import InputErrors, each_once, usable
from safety_harness.base.output import AS_EXPECTED, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.shipped.contents import located
from safety_harness.base.whole_file import write_text
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry, confirming_world, world_named
from safety_harness.extensions.attribution.attribute import (
    KINEMATIC_REPLAYS,
    Attribution,
    AttributionAnswer,
    ReplaysInWorld,
    confirmed,
)
from safety_harness.extensions.attribution.attribute import attribute as attribute_run
from safety_harness.extensions.attribution.search_attribution import confirming_line
from safety_harness.extensions.attribution.shielding import attribute_shield
from safety_harness.extensions.attribution.tally import AttributionTally
from safety_harness.report.run_result import RunResult, draw_page
from safety_harness.report.shielding import slowings
from safety_harness.scenario.expand import gather
from safety_harness.scenario.files import as_path
from safety_harness.scenario.kinds import FileKind, command_for, kind_of
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.trace.store import load_trace
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import refuse_not_simulated

__all__ = ["AttributionResult", "attribute"]

DATA, PICTURE = "attribution.json", "attribution.svg"
TRACE = ".trace"

Attributable = str | Path | Scenario | Trace | RunResult


def attribute(
    runs: Attributable | Iterable[Attributable],
    *,
    avoider: str | None = None,
    controller: str | None = None,
    safety_filter: str | None = None,
    predictor: str | None = None,
    confirm: bool = False,
    world: WorldEntry | str | None = None,
    output: Output = QUIET,
) -> AttributionResult:
    """Find the causes of violations by repeating each run with one or two parts of the system changed.

    The result reports each change after which the run no longer violates the claim.

    Ctrl-C ends the job, and the result then contains the attributions that were finished.

    Args:
        runs: One or several inputs: a result of ``run``, a trace or its file, a scenario or its file, or a
            folder.
        avoider: The avoider with which a trace is repeated. The harness executes an avoider's program only if
            the caller states the avoider.
        controller: The controller with which a trace is repeated. The harness executes a controller's program
            only if the caller states the controller.
        safety_filter: The safety filter with which a trace is repeated. The harness executes a filter's
            program only if the caller states the filter.
        predictor: The predictor with which a trace is repeated. The harness executes a predictor's program
            only if the caller states the predictor.
        confirm: Whether to repeat each violation in PyBullet, both unchanged and with the blamed parts
            changed.
        world: The world of the replays, such as the user's simulator. The default is the kinematic world.
        output: The ``Output`` that shows the progress.

    Raises:
        InputErrors: Inputs cannot be used. In this case, no run was repeated.
        InputError: An option cannot be used, or the world is not installed.

    """
    tested = one_of(avoider, controller)
    replays = ReplaysInWorld(world_named(world, "world") if isinstance(world, str) else world or KINEMATIC)
    replays.world.opener()
    if confirm:
        confirming_world().opener()
    scenarios, errors = _scenarios(runs, tested, {"safety_filter": safety_filter, "predictor": predictor})
    admitted, refused = usable(scenarios, Admitter().admit)
    if all_refused := each_once([*errors, *refused]):
        for error in all_refused:
            output.explain(error)
        raise InputErrors(all_refused, left=len(admitted))
    ready = [(run, ()) for run in admitted]
    attributed = attribute_all(ready, len(admitted), "runs", confirm, output, replays)
    if not (attributed.attributions or attributed.failed or attributed.interrupted):
        output.say(f"{len(admitted)} runs without a violation: nothing to attribute")
    return attributed


@dataclass(frozen=True, eq=False, repr=False)
class AttributionResult:
    """The causes of the violations of runs.

    Args:
        attributions: The causes of each violation.
        failed: Whether a run could not be repeated.
        interrupted: Whether Ctrl-C ended the job.
        world: The world of the replays.

    """

    attributions: tuple[Attribution, ...]
    failed: bool = False
    interrupted: bool = False
    world: WorldEntry = KINEMATIC

    @property
    def tally(self) -> AttributionTally:
        """Return the attributions, counted by cause."""
        return AttributionTally.from_attributions(self.attributions)

    @property
    def exit_code(self) -> int:
        """Return the command's exit code."""
        if self.interrupted:
            return INTERRUPTED
        missing = any(entry.answer is AttributionAnswer.NOT_ATTRIBUTED for entry in self.attributions)
        return DIFFERS if missing or self.failed else AS_EXPECTED

    def __repr__(self) -> str:
        summary = self.tally.summary if self.attributions else "nothing to attribute"
        return f"<violations in {self.world}, {summary}>"

    def data(self) -> dict[str, object]:
        """Return the content of attribution.json."""
        return self.tally.as_json()

    def write(self, folder: str | Path) -> AttributionResult:
        """Write attribution.json and attribution.svg.

        Raise OutputError if the folder cannot be written.
        """
        write_text(Path(folder) / DATA, json.dumps(self.data(), indent=1) + "\n")
        draw_page("attribution", Path(folder) / PICTURE, self.tally.groups)
        return self


def attribute_all(
    runs: Iterable[tuple[Admitted, Sequence[Claim]]],
    count: int,
    unit: str,
    confirm: bool,
    output: Output,
    replays: ReplaysInWorld = KINEMATIC_REPLAYS,
) -> AttributionResult:
    """Attribute the violations of runs and print the results, until all runs are done or Ctrl-C is pressed.

    Args:
        runs: Each run with the claims to attribute. An empty list means all claims of the run.
        count: The number of runs, which the progress display shows.
        unit: The word for one run in the progress display.
        confirm: Whether each attribution is repeated in PyBullet.
        output: The ``Output`` that prints the lines.
        replays: The runner of the replays.

    """
    done: list[Attribution] = []
    failed = interrupted = False
    try:
        with output.counting(count, unit) as show:
            show(0)
            for number, (admitted, claims) in enumerate(runs, start=1):
                try:
                    attributions = attribute_run(admitted, claims, run=replays)
                    shield = attribute_shield(admitted, replays)
                except Exception as error:  # one run's failure must not cost the others' answers
                    failed = True
                    output.say(f"error: {admitted.scenario.name} could not be run again: {described(error)}")
                else:
                    if shield is not None:
                        output.result(f"{admitted.scenario.name}: {shield.summary}")
                        output.result(*(f"    {entry}" for entry in slowings(shield.trace)))
                    for entry in attributions:
                        done.append(entry)
                        for line in _lines(entry, admitted if confirm else None):
                            output.result(line)
                show(number)
    except KeyboardInterrupt:
        interrupted = True
    return AttributionResult(tuple(done), failed, interrupted, replays.world)


def _lines(cause: Attribution, confirming: Admitted | None) -> Iterator[str]:
    """Yield the line on one violation.

    If ``confirming`` is given, also yield a line on each run in PyBullet.
    """
    yield f"{cause.scenario}: {cause.claim.sentence}: {cause.unit.margin_text(cause.margin)}: {cause.summary}"
    if confirming is not None and cause.answer is not AttributionAnswer.NOT_ATTRIBUTED:
        yield from (f"    {confirming_line(again, cause)}" for again in confirmed(confirming, cause))


def _scenarios(
    runs: Attributable | Iterable[Attributable], avoider: str | None, beside: Mapping[str, str | None]
) -> tuple[list[Scenario], list[InputError]]:
    """Return the scenarios to repeat, and the errors.

    The scenario of a trace contains only the claims that the trace violates.
    """
    given = list(runs) if isinstance(runs, Iterable) and not isinstance(runs, str) else [runs]
    kept: list[tuple[Trace, Path | None]] = []
    scenarios: list[Scenario] = []
    paths: list[Path] = []
    for item in given:
        if isinstance(item, RunResult):
            kept += [(run.trace, run.trace_file) for run in item.runs]
        elif isinstance(item, Trace):
            kept.append((item, None))
        elif isinstance(item, Scenario):
            scenarios.append(item)
        else:
            paths.append(located(item) if isinstance(item, Path) else as_path(item, "attribute(runs)"))
    traces = [path for path in paths if path.suffix == TRACE]
    files = [path for path in paths if path.suffix != TRACE and not path.is_dir()]
    errors: list[InputError] = []
    for folder in (path for path in paths if path.is_dir()):
        own, stored = sorted(folder.glob("*.yaml")), sorted(folder.rglob(f"*{TRACE}"))
        files += own
        # A trace beside its scenario is of the same run, so the scenario suffices.
        traces += [path for path in stored if path.with_suffix(".yaml") not in own]
        if not (own or stored):
            expected = f"a folder with scenario files (*.yaml) or traces (*{TRACE})"
            kind = kind_of(folder) or FileKind.FOLDER
            got, hint = f"{kind.words} without any", command_for(folder, kind)
            errors.append(ScenarioError(place=Place(file=folder), expected=expected, got=got, hint=hint))
    gathered = gather(files) if files else None
    named = [*(gathered.scenarios if gathered else ()), *scenarios]
    chosen, refused = usable(named, lambda item: item if avoider is None else with_avoider(item, avoider))
    violated, unread = usable(traces, lambda path: _violated(load_trace(path), path, avoider, beside))
    more, unusable = usable(kept, lambda item: _violated(*item, avoider, beside))
    violated, unread = [*violated, *more], [*unread, *unusable]
    errors += [*(gathered.errors if gathered else ()), *refused, *unread]
    return [*chosen, *(item for item in violated if item.claims)], errors


def _violated(
    trace: Trace, path: Path | None, avoider: str | None, beside: Mapping[str, str | None]
) -> Scenario:
    """Return the scenario of a trace with only the claims that the trace violates."""
    refuse_not_simulated(trace, path)
    scenario = with_program(trace.scenario, avoider, path, "attribute", beside)
    refuse_other_parts(trace, scenario, path)
    evaluations = judge(trace, file=path)
    claims = tuple(
        replace(claim, expected=Verdict.VIOLATED)
        for claim, evaluation in zip(trace.scenario.claims, evaluations, strict=True)
        if evaluation.verdict is Verdict.VIOLATED
    )
    return replace(scenario, claims=claims)
