"""The outcome of a self-test as files: JSON for the certification page and other programs, and a page.

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
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.claims.properties.tally import basis
from safety_harness.extensions.assurance.certification.tools import FaultState
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
from safety_harness.report.page_parts import render_page
from safety_harness.report.replay import Replays
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
    """How it came about.  ``interrupted``: of the ``planned`` faults some were not tried."""

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
    remarks: tuple[str, ...] = ()
    interrupted: bool = False


def document(outcomes: Sequence[FaultOutcome], about: SelfTestRun) -> dict[str, Any]:
    """Plain JSON; a magnitude that is not finite is null, its words are there."""
    tally = tally_of(outcomes)
    return {
        "format": FORMAT,
        "about": asdict(about) | {"generated_at": about.generated_at.isoformat()},
        "tally": asdict(tally) | {"kill_rate": tally.kill_rate},
        "faults": [_outcome(one) for one in outcomes],
    }


def write_document(path: Path, outcomes: Sequence[FaultOutcome], about: SelfTestRun) -> None:
    """Whole or not at all.  Raises OSError."""
    text = json.dumps(document(outcomes, about), indent=1, allow_nan=False, ensure_ascii=False)
    write_whole(path, text + "\n")


def _outcome(one: FaultOutcome) -> dict[str, Any]:
    plain = asdict(one)
    for rung in plain["rungs"]:
        if abs(rung["magnitude"]) == float("inf"):
            rung["magnitude"] = None
    alarm, smallest, survivor = one.alarm, one.smallest, one.survivor
    return plain | {
        "state": one.state.value,
        "caught_by": alarm.claim if alarm else None,
        "scenario": alarm.scenario if alarm else None,
        "after_episodes": smallest.episodes if smallest else None,
        "slightest_caught": smallest.words if smallest else None,
        "survives": survivor.words if survivor else None,
        "confirmed_in_pybullet": one.confirmed,
    }


CaughtRuns = Sequence[tuple[FaultOutcome, JudgedRun]]


def write_page(
    path: Path, outcomes: Sequence[FaultOutcome], about: SelfTestRun, runs: CaughtRuns = ()
) -> None:
    """Write the page whole or not at all; it asks nothing of the network.  Raises OSError."""
    write_whole(path, render(outcomes, about, runs))


def render(outcomes: Sequence[FaultOutcome], about: SelfTestRun, runs: CaughtRuns = ()) -> str:
    """The page as text; the same arguments give the same bytes.  ``runs`` are replayed in 3-D on it."""
    faults, harmless = in_table(outcomes)
    replays = Replays()
    worlds = [str(KINEMATIC), *[str(PYBULLET)] * any(one.confirmed is not None for one in outcomes)]
    return render_page(
        "selftest.html.j2",
        of="safety_harness.extensions.selftest",
        basis=basis(worlds, f"{len(outcomes)} of {about.planned} faults tried"),
        style="tables.css",
        about=about,
        tally=tally_of(outcomes),
        summary=summary(tally_of(outcomes)),
        bad=bad(outcomes),
        faults=[(one, row(one)) for one in faults],
        harmless=[(one, harmless_row(one)) for one in harmless],
        names=HEAD,
        harmless_names=HARMLESS_HEAD,
        state_class=STATE_CLASS,
        minus=with_minus,
        replays=bool(runs),
        seen=[
            (one, run, replays.of(run, f"seen-{number}")) for number, (one, run) in enumerate(runs, start=1)
        ],
    )
