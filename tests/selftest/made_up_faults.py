"""Outcomes that no trial made."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from safety_harness.extensions.selftest.document import SelfTestRun
from safety_harness.extensions.selftest.outcome import FaultOutcome
from safety_harness.extensions.selftest.trial import Alarm, Geometry, Rung

ALARM = Alarm(claim="hand distance never below 50 mm", scenario="a visit", margin="-3.0 mm", before="+9 mm")


TRUE = replace(ALARM, true=True)


def rung(magnitude: float, *alarms: Alarm, caught: bool = False, confirmed: bool | None = None) -> Rung:
    return Rung(
        magnitude=magnitude,
        words=f"{magnitude:g} mm",
        episodes=3,
        alarms=(*alarms, ALARM) if caught else alarms,
        confirmed=confirmed,
        confirming="" if confirmed is None else "PyBullet",
    )


def looked_at(one: Rung, *contradicted: str) -> Rung:
    return replace(one, geometry=Geometry(runs=3, kept=1, broken=2, contradicted=contradicted))


def outcome(
    name: str, *rungs: Rung, harmless: str = "", limit: str = "", applies: bool = True
) -> FaultOutcome:
    return FaultOutcome(
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
QUIET = outcome("quiet", looked_at(rung(1.0)), harmless="it is so")
LOUD = outcome("loud", looked_at(rung(1.0, caught=True)), harmless="it is so")
WRONGED = outcome("wronged", looked_at(rung(1.0, TRUE)), harmless="it is so")
EVERY_KIND = (CAUGHT, SURVIVES, LIMIT, UNTOUCHED, QUIET, LOUD, WRONGED)


def about(*, interrupted: bool = False) -> SelfTestRun:
    return SelfTestRun(
        profile="quick",
        avoider=None,
        scenarios="scenarios",
        episodes=3,
        planned=8,
        seconds=12.0,
        command="safety-harness selftest",
        package_version="0",
        source_hash="0",
        platform="here",
        generated_at=datetime(2026, 11, 21, tzinfo=UTC),
        interrupted=interrupted,
    )
