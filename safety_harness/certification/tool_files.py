"""What is known of the harness itself, from files: its trial on seeded faults, its independent oracles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from safety_harness.certification.tools import CaughtFault, FaultState, Oracle, SelfTest
from safety_harness.compiled import source_hash
from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.typed_json import of_format, read_json, typed

FORMAT = "safety-harness selftest 1"
ON_TRIAL = (FaultState.CAUGHT, FaultState.SURVIVES, FaultState.LIMIT)
Difference = Annotated[float, Meta(gt=-1e100, lt=1e100)]


@dataclass(frozen=True)
class _About:
    profile: str
    planned: int
    interrupted: bool
    command: str
    source_hash: str


@dataclass(frozen=True)
class _Fault:
    state: FaultState
    fault: str | None = None
    part: str | None = None
    hazard: str | None = None
    caught_by: str | None = None
    slightest_caught: str | None = None
    limit: str | None = None


@dataclass(frozen=True)
class _Trial:
    about: _About
    faults: tuple[_Fault, ...]


@dataclass(frozen=True)
class _Oracle:
    what: str
    oracle: str
    unit: str
    largest: Difference


def read_selftest(path: Path) -> SelfTest:
    """InputError, naming the field, for what is no such file, or for one of a trial without any fault."""
    found = typed(of_format(read_json(path, "a selftest.json"), FORMAT, path), _Trial, path, others=True)
    about, tried = found.about, found.faults
    faults = tuple(_caught(one) for one in tried if one.state in ON_TRIAL)
    if not faults:
        place = Place(file=path, field="faults")
        raise InputError(place=place, expected="at least one fault that was on trial", got="none")
    return SelfTest(
        profile=about.profile,
        faults=faults,
        false_alarms=tuple(str(one.fault) for one in tried if one.state is FaultState.FALSE_ALARM),
        source_hash=about.source_hash,
        present=about.source_hash == source_hash(),
        whole=not about.interrupted
        and len(tried) >= about.planned
        and "--fault" not in about.command.split(),
    )


def read_oracles(path: Path) -> tuple[Oracle, ...]:
    """The table that ``make oracles`` writes; InputError for what is none."""
    found = typed(read_json(path, "a table of oracles"), list[_Oracle], path, others=True)
    return tuple(
        Oracle(part=one.what, against=one.oracle, largest=f"{one.largest:.2g} {one.unit}") for one in found
    )


def _caught(one: _Fault) -> CaughtFault:
    caught = one.state is FaultState.CAUGHT
    return CaughtFault(
        name=one.fault or "",
        part=one.part or "",
        hazard=one.hazard or "",
        caught_by=(one.caught_by or "a claim that is not named") if caught else "",
        smallest=one.slightest_caught or "",
        known_limit=one.limit or "",
    )
