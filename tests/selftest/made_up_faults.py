"""Outcomes that no trial made."""

from __future__ import annotations

from datetime import UTC, datetime

from safety_harness.selftest.document import About
from safety_harness.selftest.outcome import Outcome
from safety_harness.selftest.trial import Alarm, Rung

ALARM = Alarm(claim="hand distance never below 50 mm", scenario="a visit", margin="-3.0 mm", before="+9 mm")


def rung(magnitude: float, *, caught: bool, confirmed: bool | None = None) -> Rung:
    alarms = (ALARM,) if caught else ()
    return Rung(
        magnitude=magnitude, words=f"{magnitude:g} mm", episodes=3, alarms=alarms, confirmed=confirmed
    )


def outcome(name: str, *rungs: Rung, harmless: str = "", limit: str = "", applies: bool = True) -> Outcome:
    return Outcome(
        fault=name,
        part="motion",
        hazard="<b>made up</b>",
        circumstance="as it is",
        harmless=harmless,
        rungs=rungs,
        slightest="1 mm",
        limit=limit,
        applies=applies,
    )


CAUGHT = outcome(
    "caught", rung(9.0, caught=True), rung(5.0, caught=True, confirmed=True), rung(2.0, caught=False)
)
SURVIVES = outcome("survives", rung(float("inf"), caught=False))
LIMIT = outcome("limit", rung(1.0, caught=False), limit="nobody looks there")
UNTOUCHED = outcome("untouched", applies=False)
QUIET = outcome("quiet", rung(1.0, caught=False), harmless="it is so")
LOUD = outcome("loud", rung(1.0, caught=True), harmless="it is so")
EVERY_KIND = (CAUGHT, SURVIVES, LIMIT, UNTOUCHED, QUIET, LOUD)


def about(*, interrupted: bool = False) -> About:
    return About(
        profile="quick",
        avoider=None,
        scenarios="scenarios",
        episodes=3,
        pool=0,
        planned=8,
        seconds=12.0,
        command="safety-harness selftest",
        package_version="0",
        source_hash="0",
        platform="here",
        generated_at=datetime(2026, 11, 21, tzinfo=UTC),
        interrupted=interrupted,
    )
