"""Runs for the page: of each claim that caught a fault, the first such fault, run again as it was caught."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.extensions.selftest.catalogue import EVERY
from safety_harness.extensions.selftest.outcome import FaultOutcome
from safety_harness.extensions.selftest.suite import claims_of
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import Rung
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.replay import MOST_REPLAYS


def caught_runs(
    outcomes: Sequence[FaultOutcome], episodes: Sequence[Admitted], most: int = MOST_REPLAYS
) -> list[tuple[FaultOutcome, JudgedRun]]:
    """At most so many faults, each with the run in which a claim told of it at its slightest.

    A claim shows one fault, so that as many claims as can are seen; what no claim told (a run that failed, an
    answer that was not repeated) is left out.  Ctrl-C raises KeyboardInterrupt.
    """
    seen, found = set[str](), list[tuple[FaultOutcome, JudgedRun]]()
    for one, rung, claim in _told(outcomes):
        if claim in seen or len(found) == most:
            continue
        run = _again(one, rung, claim, episodes[rung.episodes - 1])
        if run is not None:
            seen.add(claim)
            found.append((one, run))
    return found


def _told(outcomes: Sequence[FaultOutcome]) -> Iterator[tuple[FaultOutcome, Rung, str]]:
    """Faults that were caught, the slightest magnitude, and the first claim that told of it."""
    for one in outcomes:
        if not one.harmless and one.smallest is not None and one.alarm is not None:
            yield one, one.smallest, one.alarm.claim


def _again(one: FaultOutcome, rung: Rung, sentence: str, episode: Admitted) -> JudgedRun | None:
    """The run with the fault, judged by that claim alone; None if it is no claim's."""
    claims = [claim for claim in claims_of(episode.scenario) if claim.sentence == sentence]
    if not claims:
        return None
    (fault,) = (fault for fault in EVERY if fault.name == one.fault)
    around = fault.circumstance.bring_about(ChangedSystem(episode))
    trace = fault.seed_into(around, rung.magnitude).run()
    judged = replace(trace, scenario=replace(trace.scenario, claims=tuple(claims[:1])))
    return JudgedRun(judged, (property_of(claims[0], trace.scenario).evaluate(trace),), "")
