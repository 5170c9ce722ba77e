"""Write a self-test's outcome as JSON, for the certification page and other programs, and as a page.

The page is self-contained HTML in the style of the reports.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from safety_harness.base.whole_file import write_whole
from safety_harness.cell.simulation.worlds import KINEMATIC, world_labelled
from safety_harness.claims.properties.tally import basis
from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.replay import Replays
from safety_harness.extensions.selftest.outcome import (
    HARMLESS_HEAD,
    HEAD,
    FaultOutcome,
    bad,
    harmless_row,
    in_table,
    row,
    summary,
    tally_of,
)
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import with_minus

FORMAT = "safety-harness selftest 1"
STATE_CLASS = {
    FaultState.CAUGHT: "holds",
    FaultState.QUIET: "holds",
    FaultState.SURVIVES: "violated",
    FaultState.FALSE_ALARM: "violated",
    FaultState.LIMIT: "inconclusive",
    FaultState.TRUE_ALARM: "inconclusive",
    FaultState.UNTOUCHED: "none",
}


@dataclass(frozen=True, kw_only=True)
class SelfTestRun:
    """The circumstances of a self-test.

    ``planned`` is the number of faults to try. If the self-test was ``interrupted``, some of them were not
    tried.
    """

    profile: str
    avoider: str | None
    scenarios: str
    episodes: int
    planned: int
    seconds: float
    command: str
    package_version: str
    source_hash: str
    platform: str
    generated_at: datetime
    safety_filter: str | None = None
    predictor: str | None = None
    world: str = KINEMATIC.label
    remarks: tuple[str, ...] = ()
    interrupted: bool = False


def document(outcomes: Sequence[FaultOutcome], selftest: SelfTestRun) -> dict[str, Any]:
    """Return the outcome as data for JSON.

    A magnitude that is not finite becomes null; the text of the magnitude is always present.
    """
    tally = tally_of(outcomes)
    return {
        "format": FORMAT,
        "about": asdict(selftest) | {"generated_at": selftest.generated_at.isoformat()},
        "tally": asdict(tally) | {"kill_rate": tally.kill_rate},
        "faults": [_outcome(outcome) for outcome in outcomes],
    }


def write_document(path: Path, outcomes: Sequence[FaultOutcome], selftest: SelfTestRun) -> None:
    """Write the JSON file in full or not at all; raise OSError if it cannot be written."""
    text = json.dumps(document(outcomes, selftest), indent=1, allow_nan=False, ensure_ascii=False)
    write_whole(path, text + "\n")


def _outcome(outcome: FaultOutcome) -> dict[str, Any]:
    plain = asdict(outcome)
    for rung in plain["rungs"]:
        if abs(rung["magnitude"]) == float("inf"):
            rung["magnitude"] = None
    alarm, smallest, survivor = outcome.alarm, outcome.smallest, outcome.survivor
    return plain | {
        "state": outcome.state.value,
        "caught_by": alarm.claim if alarm else None,
        "scenario": alarm.scenario if alarm else None,
        "after_episodes": smallest.episodes if smallest else None,
        "slightest_caught": smallest.words if smallest else None,
        "survives": survivor.words if survivor else None,
        "confirmed_in": outcome.confirmed_in,
    }


CaughtRuns = Sequence[tuple[FaultOutcome, JudgedRun]]


def write_page(
    path: Path, outcomes: Sequence[FaultOutcome], selftest: SelfTestRun, runs: CaughtRuns = ()
) -> None:
    """Write the page completely or not at all; raise OSError if that fails. The page needs no network."""
    write_whole(path, render(outcomes, selftest, runs))


def render(outcomes: Sequence[FaultOutcome], selftest: SelfTestRun, runs: CaughtRuns = ()) -> str:
    """Return the text of the page, which depends only on the arguments.

    The page replays ``runs`` in 3-D.
    """
    faults, harmless = in_table(outcomes)
    replays = Replays()
    confirming = {rung.confirming for case in outcomes for rung in case.rungs if rung.confirming}
    worlds = [str(world_labelled(selftest.world) or selftest.world), *sorted(confirming)]
    return render_page(
        "selftest.html.j2",
        package="safety_harness.extensions.selftest",
        world=worlds[0],
        basis=basis(worlds, f"{len(outcomes)} of {selftest.planned} faults tried"),
        style="tables.css",
        about=selftest,
        tally=tally_of(outcomes),
        summary=summary(tally_of(outcomes)),
        bad=bad(outcomes),
        faults=[(case, row(case)) for case in faults],
        harmless=[(case, harmless_row(case)) for case in harmless],
        names=HEAD,
        harmless_names=HARMLESS_HEAD,
        state_class=STATE_CLASS,
        minus=with_minus,
        replays=bool(runs),
        seen=[
            (case, run, replays.arguments(run, f"seen-{number}"))
            for number, (case, run) in enumerate(runs, start=1)
        ],
    )
