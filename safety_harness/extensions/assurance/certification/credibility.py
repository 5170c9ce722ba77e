"""Reasons to believe the simulator's numbers: repeated runs, agreement of the worlds, oracles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.agreement import measured_agreement
from safety_harness.admission.avoiders import is_a_program
from safety_harness.admission.trial import judge, run_trial
from safety_harness.cell.simulation.worlds import WORLDS, WorldEntry, entry_of
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.assurance.certification.stored import Stored
from safety_harness.extensions.assurance.certification.tools import (
    Credibility,
    HarnessTrials,
    Rerun,
    WorldAgreement,
)
from safety_harness.report.words import with_minus
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.trace.trace import Trace

MOST_RERUNS = 12  # they take some seconds
JOINTS = "position of a joint, beside the margins"
NO_CELL = "Nothing here was measured on a real cell."


def credibility_of(
    stored: Sequence[Stored], trials: HarnessTrials, *, reruns: tuple[Rerun, ...] | None = None
) -> Credibility:
    """Return the measured evidence on the simulator, and a reason for each measurement that is missing.

    Args:
        stored: The stored random runs. At most ``MOST_RERUNS`` of these runs, spread evenly, are run again.
        trials: The oracles and the recorded cells.
        reruns: Known results that replace new runs. The default is to repeat runs on this machine.

    """
    complete = [item.trace for item in stored if item.trace.complete]
    chosen = complete[:: max(1, -(-len(complete) // MOST_RERUNS))]  # spread evenly
    absent = _no_reruns(chosen)
    if reruns is None or absent:
        reruns = () if absent else _reruns_of(chosen)
    try:
        agreement = agreement_of()
    except OSError:
        agreement = None
        absent.append("This version lacks a measured agreement of the two worlds.")
    missing = (item for item in WORLDS if not item.is_installed)
    absent += [f"{item} is not installed: this report repeats no run in it." for item in missing]
    if not trials.oracles:
        absent.append(
            "This report has no disagreements with other software (kinematics, distances, filter, networks, "
            "formulas): the package's own tests measure them."
        )
    return Credibility(
        agreement=agreement,
        reruns=reruns,
        oracles=trials.oracles,
        oracles_measured_with=trials.oracles_with,
        absent=(*absent, *[NO_CELL] * (not trials.cells)),
        cells=trials.cells,
    )


def agreement_of() -> WorldAgreement:
    """Return the agreement of the two worlds, which was measured beforehand and ships with the package.

    Raises:
        OSError: The package has no measured agreement.

    """
    measured = measured_agreement()
    verdicts = measured.compared + measured.compared_near
    return WorldAgreement(
        scenarios=measured.scenarios,
        verdicts=verdicts,
        disagreements=verdicts - measured.agreed - measured.agreed_near,
        optimistic=len(measured.optimistic),
        differences=tuple((gap.what, f"{gap.largest:.3g} in {gap.scenario}") for gap in measured.differences),
        source_hash=measured.source,
        present=measured.is_of_present_source,
    )


def _no_reruns(chosen: Sequence[Trace]) -> list[str]:
    """Return the reasons why no run can be repeated here.

    The list is empty if runs can be repeated.
    """
    if not chosen:
        return [
            "The ledger stores no declared random run, so this report repeats no run with other step sizes."
        ]
    if any(is_a_program(trace.scenario.under_test) or trace.scenario.has_parts_beside for trace in chosen):
        return ["This report repeats no run of a user's program: verify --execute-programs does."]
    return []


def _reruns_of(chosen: Sequence[Trace]) -> tuple[Rerun, ...]:
    """Repeat declared random runs with smaller physics steps, and in every other world."""
    reruns, own = [], entry_of(chosen[0].provenance.world)
    if own is not None and own.substeps and not own.program:
        substeps = chosen[0].scenario.settings.clock.physics_substeps
        how = f"with {2 * substeps} physics steps a control tick in place of {substeps}"
        reruns.append(_rerun(chosen, own, "step-size", "Finer physics steps", how, change=_finer))
    for entry in WORLDS:
        if entry is not own and entry.is_installed:
            title, how = f"These runs in {entry}", f"in {entry} in place of {own}"
            reruns.append(_rerun(chosen, entry, "other-world", title, how))
    return tuple(reruns)


def _finer(scenario: Scenario) -> Scenario:
    """Return ``scenario`` with half the physics step."""
    clock = scenario.settings.clock
    finer = replace(clock, physics_substeps=2 * clock.physics_substeps)
    return replace(scenario, settings=replace(scenario.settings, clock=finer))


def _rerun(
    traces: Sequence[Trace],
    world: WorldEntry,
    place: str,
    title: str,
    how: str,
    *,
    change: Callable[[Scenario], Scenario] = lambda scenario: scenario,
) -> Rerun:
    """Apply ``change`` to the scenarios of ``traces``, run them in ``world``, and count the changed verdicts.

    If a run cannot be repeated, each of its verdicts is treated as changed.
    """
    verdicts = changed = optimistic = 0
    largest: dict[str, tuple[float, str]] = {}
    for trace in traces:
        first = judge(trace)
        verdicts += len(first)
        try:
            run = run_trial(admit(change(trace.scenario)), world=world)
            second = judge(run)
        except Exception:  # a user's program may raise anything
            changed += len(first)
            continue
        _note_joints(largest, trace, run)
        for old, new in zip(first, second, strict=True):
            changed += old.verdict is not new.verdict
            optimistic += old.verdict is Verdict.HOLDS and new.verdict is Verdict.VIOLATED
            _note(largest, old, new)
    return Rerun(
        place=place,
        title=title,
        how=how,
        runs=len(traces),
        verdicts=verdicts,
        changed=changed,
        optimistic=optimistic,
        largest=tuple((sentence, text) for sentence, (_, text) in largest.items()),
    )


def _note_joints(largest: dict[str, tuple[float, str]], first: Trace, second: Trace) -> None:
    """Record in ``largest`` by how much the joint positions of two runs differ.

    The function keeps this value only if no earlier value is larger. A difference of 0 shows that physics had
    no effect.
    """
    ends = min(len(first.ticks), len(second.ticks))
    columns = [run.ticks["joint_position_rad"][:ends] for run in (first, second)]
    apart_rad = float(np.abs(columns[1] - columns[0]).max(initial=0.0))
    if apart_rad >= largest.get(JOINTS, (0.0, ""))[0]:
        largest[JOINTS] = (apart_rad, f"{apart_rad:.3g} rad")


def _note(largest: dict[str, tuple[float, str]], old: Evaluation, new: Evaluation) -> None:
    """Record in ``largest`` by how much the margin of a claim changed.

    The value is kept only if no earlier change of this margin is larger.
    """
    if old.margin is None or new.margin is None:
        return
    difference = new.margin - old.margin
    if abs(difference) >= largest.get(old.sentence, (0.0, ""))[0]:
        shown = with_minus(f"{difference * old.unit.per_si:+.3g} {old.unit.symbol}".rstrip())
        largest[old.sentence] = (abs(difference), shown)
