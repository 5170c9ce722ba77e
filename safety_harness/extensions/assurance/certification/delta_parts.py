"""Find the differences between two evidence reports, except differences in results.

The differences concern the software, system, settings, plan, space and files.
"""

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
    """A changed part of the software, the system or the plan.

    ``NONE`` is the value of a missing part.
    """

    part: str
    name: str
    before: str
    after: str


def both(old: Mapping[str, T], new: Mapping[str, T]) -> Iterator[tuple[str, T | None, T | None]]:
    """Yield each key of ``old`` or ``new`` with its two values.

    If a mapping lacks the key, the value for this mapping is None.
    """
    for name in dict.fromkeys([*old, *new]):
        yield name, old.get(name), new.get(name)


def proofs_in(evidence: Evidence) -> dict[str, str]:
    """Return the verdict on each proven claim of ``evidence``.

    The key of a verdict has the claim's sentence and region.
    """
    claims = evidence.proven.claims if evidence.proven else ()
    return {f"{claim.claim}, {claim.region}": claim.verdict for claim in claims}


def parts_changed(old: Evidence, new: Evidence) -> Iterator[PartChange]:
    """Yield every part that differs between ``old`` and ``new`` and is not a result of runs."""
    for part, read in _PARTS.items():
        for name, was, now in both(read(old), read(new)):
            if was != now:
                yield PartChange(part, name, NONE if was is None else was, NONE if now is None else now)
    yield from _only_earlier(old, new)


def _software(evidence: Evidence) -> dict[str, str]:
    made = evidence.provenance
    parts = {"package": made.package_version, "source": made.source_hash, "Python": made.python}
    return parts | {"platform": made.platform} | dict(made.libraries)


def _system(evidence: Evidence) -> dict[str, str]:
    facts: dict[str, str] = {}
    for name, text in (*evidence.system.facts, *evidence.system.card, *evidence.system.gate):
        facts[name] = f"{facts[name]}; {text}" if name in facts else text
    return facts | {f"limit {k}": text for k, text in enumerate(evidence.system.limits, start=1)}


def _settings(evidence: Evidence) -> dict[str, str]:
    own = {f"{name}, in the plan": f"{value}, not {usual}" for name, usual, value in evidence.system.changed}
    return dict(evidence.system.settings) | own


_OF_PLAN = ("name", "world", "confidence", "seed", "stop_early", "search_runs", "about")


def _plan(evidence: Evidence) -> dict[str, str]:
    plan = {name: str(getattr(evidence.plan, name)) for name in _OF_PLAN}
    lodged = evidence.record.declaration_sha256
    return plan | ({"declaration": lodged} if lodged else {})


def _spaces(evidence: Evidence) -> dict[str, str]:
    return {item.name: f"{item.planned} runs, sha256 {item.space_sha256[:16]}" for item in evidence.strata}


def _files(evidence: Evidence) -> dict[str, str]:
    return {file.path: file.sha256[:16] for file in evidence.files if file.path.startswith("plan/")}


def _hazards(evidence: Evidence) -> dict[str, str]:
    return {
        item.name: f"{item.severity}, {item.exposure}, {item.avoidance}; {item.approaches}; asked an hour: "
        f"{'nothing' if item.asked_an_hour is None else f'{item.asked_an_hour:g}'}"
        for item in evidence.hazards
    }


def _learned(evidence: Evidence) -> dict[str, str]:
    """Return the distance of each stratum from the training data, and the statements on the learned part."""
    if evidence.learned is None:
        return {}
    return dict(evidence.learned.life) | {row.stratum: _distance(row) for row in evidence.learned.strata}


def _distance(row: TrainingDistance) -> str:
    runs = ", ".join(f"{count} {name}" for name, count in zip(SEEN, row.runs, strict=True))
    if row.share_outside is None:
        return f"runs: {runs}; no decision is stored"
    far_m = row.largest_outside_m
    far = "" if far_m is None else f", {1e3 * far_m:.0f} mm at most"
    return f"runs: {runs}; hands outside of training: {percent(row.share_outside)} of {row.decisions}{far}"


def _coverage(evidence: Evidence) -> dict[str, str]:
    """Return the number of runs for each value of each axis of the coverage map."""
    cells, _ = cells_of(evidence.coverage)
    runs = {
        f"{axis}: {label}": f"{count} runs"
        for axis in AXES
        for label, count in cells.along(axis).items()
        if count
    }
    return {"cells": f"{len(cells.counts)} with {evidence.coverage.runs} runs"} | runs


def _only_earlier(old: Evidence, new: Evidence) -> Iterator[PartChange]:
    """Yield the number of cells of the coverage map in which only the earlier report has runs."""
    was, now = (cells_of(report.coverage)[0].counts.keys() for report in (old, new))
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
