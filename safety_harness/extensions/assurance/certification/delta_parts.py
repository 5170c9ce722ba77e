"""What is another in two evidence reports beside results: software, system, settings, plan, spaces, files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from safety_harness.extensions.assurance.certification.evidence import Evidence, TrainingDistance
from safety_harness.extensions.assurance.certification.stored import cells_of
from safety_harness.extensions.assurance.certification.verdicts import percent
from safety_harness.search.coverage import AXES, SEEN

NONE = "–"

T = TypeVar("T")


@dataclass(frozen=True)
class PartChange:
    """A part of the software, the system or the plan that is another; ``NONE`` where there is none."""

    part: str
    name: str
    before: str
    after: str


def both(before: Mapping[str, T], after: Mapping[str, T]) -> Iterator[tuple[str, T | None, T | None]]:
    """Each key of either, with what both have of it."""
    for name in dict.fromkeys([*before, *after]):
        yield name, before.get(name), after.get(name)


def proofs_in(evidence: Evidence) -> dict[str, str]:
    """The verdict on each proven claim, by its sentence and region."""
    claims = evidence.proven.claims if evidence.proven else ()
    return {f"{one.claim}, {one.region}": one.verdict for one in claims}


def parts_changed(before: Evidence, after: Evidence) -> Iterator[PartChange]:
    """Everything else that is another."""
    for part, of in _PARTS.items():
        for name, was, now in both(of(before), of(after)):
            if was != now:
                yield PartChange(part, name, NONE if was is None else was, NONE if now is None else now)
    yield from _only_earlier(before, after)


def _software(evidence: Evidence) -> dict[str, str]:
    made = evidence.provenance
    about = {"package": made.package_version, "source": made.source_hash, "Python": made.python}
    return about | {"platform": made.platform} | dict(made.libraries)


def _system(evidence: Evidence) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, text in (*evidence.system.facts, *evidence.system.card, *evidence.system.gate):
        found[name] = f"{found[name]}; {text}" if name in found else text
    return found | {f"limit {k}": text for k, text in enumerate(evidence.system.limits, start=1)}


def _settings(evidence: Evidence) -> dict[str, str]:
    own = {f"{name}, in the plan": f"{value}, not {usual}" for name, usual, value in evidence.system.changed}
    return dict(evidence.system.settings) | own


_OF_PLAN = ("name", "world", "confidence", "seed", "stop_early", "search_runs", "about")


def _plan(evidence: Evidence) -> dict[str, str]:
    plan = {name: str(getattr(evidence.plan, name)) for name in _OF_PLAN}
    lodged = evidence.record.declaration_sha256
    return plan | ({"declaration": lodged} if lodged else {})


def _spaces(evidence: Evidence) -> dict[str, str]:
    return {one.name: f"{one.planned} runs, sha256 {one.space_sha256[:16]}" for one in evidence.strata}


def _files(evidence: Evidence) -> dict[str, str]:
    return {one.path: one.sha256[:16] for one in evidence.files if one.path.startswith("plan/")}


def _hazards(evidence: Evidence) -> dict[str, str]:
    return {
        one.name: f"{one.severity}, {one.exposure}, {one.avoidance}; {one.approaches}; asked an hour: "
        f"{'nothing' if one.asked_an_hour is None else f'{one.asked_an_hour:g}'}"
        for one in evidence.hazards
    }


def _learned(evidence: Evidence) -> dict[str, str]:
    """By stratum how far it lies from the training, and what is said of the learned part."""
    if evidence.learned is None:
        return {}
    return dict(evidence.learned.life) | {one.stratum: _distance(one) for one in evidence.learned.strata}


def _distance(one: TrainingDistance) -> str:
    runs = ", ".join(f"{count} {name}" for name, count in zip(SEEN, one.runs, strict=True))
    if one.share_outside is None:
        return f"runs: {runs}; no decision is stored"
    far_m = one.largest_outside_m
    far = "" if far_m is None else f", {1e3 * far_m:.0f} mm at most"
    return f"runs: {runs}; hands outside of training: {percent(one.share_outside)} of {one.decisions}{far}"


def _coverage(evidence: Evidence) -> dict[str, str]:
    """How many runs were where, by each axis of the map."""
    found, _ = cells_of(evidence.coverage)
    runs = {
        f"{axis}: {word}": f"{count} runs"
        for axis in AXES
        for word, count in found.along(axis).items()
        if count
    }
    return {"cells": f"{len(found.counts)} with {evidence.coverage.runs} runs"} | runs


def _only_earlier(before: Evidence, after: Evidence) -> Iterator[PartChange]:
    """What was tried and is not any more."""
    was, now = (cells_of(one.coverage)[0].counts.keys() for one in (before, after))
    if lost := len(was - now):
        yield PartChange("coverage", "cells of which only the earlier report has runs", str(lost), NONE)


_PARTS: dict[str, Callable[[Evidence], dict[str, str]]] = {
    "software": _software,
    "system": _system,
    "settings": _settings,
    "plan": _plan,
    "hazard": _hazards,
    "training": _learned,
    "space": _spaces,
    "coverage": _coverage,
    "file": _files,
    "proof": proofs_in,
    "results": lambda evidence: {"root over all rows": evidence.record.rows_sha256[:16]},
}
