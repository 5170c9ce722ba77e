"""``safety-harness attribute``: whose fault the violations of runs are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import is_a_program, option_of, with_avoider
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, Place, ScenarioError, TraceError, described
from safety_harness.base.input_errors import usable
from safety_harness.base.shipped.contents import located
from safety_harness.base.whole_file import write_text
from safety_harness.cell.simulation.worlds import PYBULLET
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
from safety_harness.cli.progress import counting
from safety_harness.report.attribution_picture import draw_attributions
from safety_harness.report.page_parts import asset
from safety_harness.report.search_attribution import confirming_line
from safety_harness.report.shielding import slowings
from safety_harness.report.svg import standalone
from safety_harness.scenario.expand import gather
from safety_harness.scenario.kinds import FileKind, command_for, kind_of
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.search.attribution.attribute import Attribution, AttributionAnswer, attribute, confirmed
from safety_harness.search.attribution.shielding import attribute_shield
from safety_harness.search.attribution.tally import AttributionTally
from safety_harness.trace.store import load_trace
from safety_harness.trace.unmeasured import refuse_not_simulated

DATA, PICTURE = "attribution.json", "attribution.svg"
TRACE = ".trace"


def attribute_runs(paths: Sequence[Path], avoider: str | None, out: Path | None, confirm: bool) -> int:
    """Attribute, print, write; returns the exit code."""
    if confirm:
        PYBULLET.opener()
    scenarios, errors = _scenarios(paths, avoider)
    admitted, refused = usable(scenarios, Admitter().admit)
    if errors or refused:
        say(f"{len(explain_each([*errors, *refused]))} of the inputs cannot be used; nothing was run.")
        return BAD_INPUT
    session = AttributionSession(confirm)
    try:
        with counting(len(admitted), "runs") as show:
            show(0)
            for number, one in enumerate(admitted, start=1):
                session.take(one)
                show(number)
    except KeyboardInterrupt:
        session.interrupted = True
    if not session.found:
        say(f"{len(admitted)} runs without a violation: nothing to attribute")
    return conclude(session, out)


def conclude(session: AttributionSession, out: Path | None) -> int:
    """Print the groups, write the files."""
    tally = AttributionTally.of(session.found)
    result(*tally.lines())
    document(**tally.as_json())
    if out is not None:
        write_text(out / DATA, json.dumps(tally.as_json(), indent=1) + "\n")
        write_text(out / PICTURE, standalone(draw_attributions(tally.groups), style=asset("report.css")))
        say(f"picture: {out / PICTURE} (for programs: {DATA})")
    if session.interrupted:
        say("interrupted: what was attributed until then is above")
        return INTERRUPTED
    missing = any(one.answer is AttributionAnswer.NOT_ATTRIBUTED for one in session.found)
    return DIFFERS if missing or session.failed else AS_EXPECTED


@dataclass
class AttributionSession:
    """What was attributed so far."""

    confirm: bool
    found: list[Attribution] = field(default_factory=list)
    failed: bool = False
    interrupted: bool = False

    def take(self, admitted: Admitted, claims: Sequence[Claim] = ()) -> None:
        """Attribute and print the violations of one run: of these claims, or of all of its own."""
        try:
            attributions, shield = attribute(admitted, claims), attribute_shield(admitted)
        except Exception as error:  # one run's failure must not cost the others' answers
            self.failed = True
            say(f"error: {admitted.scenario.name} could not be run again: {described(error)}")
            return
        if shield is not None:
            result(f"{admitted.scenario.name}: {shield.words}")
            result(*(f"    {one}" for one in slowings(shield.trace)))
        for one in attributions:
            self.found.append(one)
            margin = one.unit.margin_text(one.margin)
            result(f"{one.scenario}: {one.claim.sentence}: {margin}: {one.words}")
            if self.confirm and one.answer is not AttributionAnswer.NOT_ATTRIBUTED:
                for again in confirmed(admitted, one):
                    result(f"    {confirming_line(again, one)}")


def _scenarios(paths: Sequence[Path], avoider: str | None) -> tuple[list[Scenario], list[InputError]]:
    """What is to be run again: of a trace its scenario, which claims what it violates."""
    paths = [located(path) for path in paths]
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
    named = gathered.scenarios if gathered else []
    chosen, refused = usable(named, lambda one: one if avoider is None else with_avoider(one, avoider))
    violated, unread = usable(traces, lambda path: _violated(path, avoider))
    errors += [*(gathered.errors if gathered else ()), *refused, *unread]
    return [*chosen, *(one for one in violated if one.claims)], errors


def _violated(path: Path, avoider: str | None) -> Scenario:
    """The scenario of a trace, with the claims that the trace violates alone."""
    trace = load_trace(path)
    refuse_not_simulated(trace, path)
    scenario = trace.scenario
    if avoider is not None:
        scenario = with_avoider(scenario, avoider)
    elif is_a_program(tested := scenario.under_test):
        option = option_of(tested)
        raise TraceError(
            place=Place(file=path, field=option.removeprefix("--")),
            expected=f"the program named with {option}, since repeating the run executes it",
            got=f"a trace made with {tested}",
        )
    evaluations = judge(trace, file=path)
    claims = tuple(
        replace(claim, expected=Verdict.VIOLATED)
        for claim, evaluation in zip(trace.scenario.claims, evaluations, strict=True)
        if evaluation.verdict is Verdict.VIOLATED
    )
    return replace(scenario, claims=claims)
