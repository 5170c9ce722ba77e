"""Select the runs that the page shows.

For each claim that caught faults, the page shows the run with the first of these faults.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.extensions.pages.replay import MOST_REPLAYS
from safety_harness.extensions.selftest.catalogue import EVERY
from safety_harness.extensions.selftest.outcome import FaultOutcome
from safety_harness.extensions.selftest.suite import claims_of
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import Rung
from safety_harness.report.evidence import JudgedRun


def caught_runs(
    outcomes: Sequence[FaultOutcome],
    episodes: Sequence[Admitted],
    world: WorldEntry = KINEMATIC,
    most: int = MOST_REPLAYS,
) -> list[tuple[FaultOutcome, JudgedRun]]:
    """Return at most ``most`` faults, each with a run at the smallest magnitude that a claim caught.

    Each claim appears with one fault only, so that the page shows as many claims as possible. A catch without
    a claim, such as a failed run or a changed answer, is omitted. Ctrl-C raises KeyboardInterrupt.
    """
    seen, runs = set[str](), list[tuple[FaultOutcome, JudgedRun]]()
    for outcome, rung, claim in _caught(outcomes):
        if claim in seen or len(runs) == most:
            continue
        run = _again(outcome, rung, claim, episodes[rung.episodes - 1], world)
        if run is not None:
            seen.add(claim)
            runs.append((outcome, run))
    return runs


def _caught(outcomes: Sequence[FaultOutcome]) -> Iterator[tuple[FaultOutcome, Rung, str]]:
    """Yield each caught fault with two values.

    They are the rung of its smallest caught magnitude, and the first claim that caught this magnitude.
    """
    for outcome in outcomes:
        if not outcome.harmless and outcome.smallest is not None and outcome.alarm is not None:
            yield outcome, outcome.smallest, outcome.alarm.claim


def _again(
    outcome: FaultOutcome, rung: Rung, sentence: str, episode: Admitted, world: WorldEntry
) -> JudgedRun | None:
    """Repeat the run with the fault, judge only the claim ``sentence``, and return the judged run.

    Return None if ``sentence`` is not a claim.
    """
    claims = [claim for claim in claims_of(episode.scenario) if claim.sentence == sentence]
    if not claims:
        return None
    (fault,) = (fault for fault in EVERY if fault.name == outcome.fault)
    around = fault.circumstance.bring_about(ChangedSystem(episode))
    trace = fault.seed_into(around, rung.magnitude).run(world)
    judged = replace(trace, scenario=replace(trace.scenario, claims=tuple(claims[:1])))
    return JudgedRun(judged, (property_of(claims[0], trace.scenario).evaluate(trace),), "")
