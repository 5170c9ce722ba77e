"""Distinct violations: the worst of each kind among the declared runs, and those that a search found.

Violations of a claim are of one kind if the hand came from the same side, the gravest decision had the same
outcome and the stratum is the same.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.certification.evidence import CounterexampleEvidence, SearchEvidence
from safety_harness.certification.stored import judged_run, trace_from
from safety_harness.exceptions import InputError, TraceError
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import margin_words
from safety_harness.search.explain import circumstances
from safety_harness.statistics.sample import Outcome
from safety_harness.trace.store import load_trace

FOLDER, SEARCH = "counterexamples", "search"
MOST = 40  # with pictures on the page: drawings and a replay take some 0.2 MB, 0.3 at most
MOST_LINES = 14
TO = "A counterexample to:"

_VIOLATIONS = (
    "SELECT e.stratum, e.episode, c.words, j.margin FROM judgement j "
    "JOIN episode e ON e.stratum = j.stratum AND e.episode = j.episode "
    "LEFT JOIN cell c ON c.id = e.cell WHERE j.claim = ? AND j.outcome = ? "
    "ORDER BY j.margin, e.stratum, e.episode"
)


@dataclass(eq=False)
class _Kind:
    """Violations that are one thing to a reader, how many there are, and the worst whose trace is kept."""

    stratum: int
    words: str
    episode: int | None = None
    count: int = 0


def declared_counterexamples(
    plan: Plan, ledger: Ledger, folder: Path
) -> Iterator[tuple[CounterexampleEvidence, JudgedRun]]:
    """Of the plan's own runs, their traces written below ``folder``; numbers are not given yet."""
    for number, claim in enumerate(plan.claims):
        for kind in _kinds(ledger, number):
            data = None if kind.episode is None else ledger.trace(kind.stratum, kind.episode)
            if data is None:
                continue
            stratum = plan.strata[kind.stratum].name
            file = folder / FOLDER / f"claim-{number + 1}-stratum-{kind.stratum + 1}-run-{kind.episode}.trace"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            run = judged_run(trace_from(data), file=file)
            yield _evidence(
                run,
                number,
                claim.sentence,
                origin=f"declared run {kind.episode} of {stratum}",
                independent=True,
                like_it=kind.count,
                folder=folder,
                scenario="",
                lines=(f"kind: {kind.words}", *_circumstances(run)),
            )


def kinds_without_trace(plan: Plan, ledger: Ledger) -> int:
    """How many kinds of violation, over all claims, have no kept trace to be shown by."""
    return sum(kind.episode is None for claim in range(len(plan.claims)) for kind in _kinds(ledger, claim))


def _kinds(ledger: Ledger, claim: int) -> list[_Kind]:
    """The worst first."""
    kept = {(stratum, episode) for stratum, episode, _ in ledger.traces()}
    found: dict[tuple[int, str], _Kind] = {}
    for stratum, episode, words, _ in ledger.all(_VIOLATIONS, claim, int(Outcome.VIOLATED)):
        parts = (words or "no hand").split(", ")
        key = (stratum, f"{parts[0]}, {parts[-1]}")
        kind = found.setdefault(key, _Kind(*key))
        kind.count += 1
        if kind.episode is None and (stratum, episode) in kept:
            kind.episode = episode
    return list(found.values())


def _circumstances(run: JudgedRun) -> tuple[str, ...]:
    try:
        lines = circumstances(run.trace)
    except InputError as error:  # the seen space of a network that is not there any more
        return (f"where it lies relative to the training data is not known: {error}",)
    more = len(lines) - MOST_LINES
    return tuple(lines[:MOST_LINES]) + ((f"and {more} more decisions",) if more > 0 else ())


def searched_counterexamples(plan: Plan, folder: Path) -> Iterator[tuple[CounterexampleEvidence, JudgedRun]]:
    """What the search wrote below ``folder``: shrunk, confirmed and explained scenario files with traces."""
    sentences = [claim.sentence for claim in plan.claims]
    for stratum, found in search_results(plan, folder):
        for name in found.get("counterexamples", []):
            file = folder / SEARCH / slug(stratum) / Path(str(name)).name
            trace = file.with_suffix(".trace")
            if not trace.is_file():
                continue
            try:
                run = judged_run(load_trace(trace), file=trace)
            except TraceError:
                continue
            sentence, lines = _told(file)
            yield _evidence(
                run,
                sentences.index(sentence) if sentence in sentences else None,
                sentence,
                origin=f"the search of {stratum}, shrunk",
                independent=False,
                like_it=1,
                folder=folder,
                scenario=file.relative_to(folder).as_posix() if file.is_file() else "",
                lines=lines[:MOST_LINES],
            )


def _evidence(
    run: JudgedRun,
    claim: int | None,
    sentence: str,
    *,
    origin: str,
    independent: bool,
    like_it: int,
    folder: Path,
    scenario: str,
    lines: Sequence[str],
) -> tuple[CounterexampleEvidence, JudgedRun]:
    assert run.trace_file is not None
    trace = run.trace_file.relative_to(folder).as_posix()
    sentences = [one.sentence for one in run.trace.scenario.claims]
    place = sentences.index(sentence) if sentence in sentences else None
    return (
        CounterexampleEvidence(
            number=0,
            claim=None if claim is None else claim + 1,
            sentence=sentence,
            origin=origin,
            independent=independent,
            like_it=like_it,
            margin="\u2013" if place is None else margin_words(run.evaluations[place]),
            scenario_file=scenario,
            trace_file=trace,
            command=shlex.join(["safety-harness", "replay", trace]),
            lines=tuple(lines),
        ),
        replace(run, replay_command=shlex.join(["safety-harness", "replay", trace])),
    )


def numbered(
    pairs: Sequence[tuple[CounterexampleEvidence, JudgedRun]],
) -> tuple[tuple[CounterexampleEvidence, ...], dict[int, JudgedRun]]:
    """Numbers from 1, and the runs by them; only the first ``MOST`` have pictures."""
    examples = tuple(replace(one, number=k) for k, (one, _) in enumerate(pairs, start=1))
    runs = {k: run for k, (_, run) in enumerate(pairs, start=1) if k <= MOST}
    return examples, runs


def _told(file: Path) -> tuple[str, list[str]]:
    """What a counterexample's file says in its comments: to what it is one, and below the gap why."""
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        lines = []
    head = [line[1:].strip() for line in lines if line.startswith("#")]
    told = next((line.removeprefix(TO).strip() for line in head if line.startswith(TO)), "something")
    return told, [line for line in head[head.index("") + 1 :] if line] if "" in head else []


def search_results(plan: Plan, folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """(stratum, what its findings.json says) for every stratum that was searched."""
    for stratum in plan.strata:
        file = folder / SEARCH / slug(stratum.name) / "findings.json"
        if file.is_file():
            try:
                found = json.loads(file.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            if isinstance(found, dict):
                yield stratum.name, found


def search_evidence(plan: Plan, folder: Path) -> SearchEvidence | None:
    """What was hunted for and how; None where the plan asks for no search or none was made."""
    results = list(search_results(plan, folder))
    if not results:
        return None
    lines = []
    for stratum, found in results:
        distinct, refuted = len(found.get("distinct", [])), len(found.get("not confirmed in PyBullet", []))
        lines.append(
            f"{stratum}: {found.get('tried', 0)} runs of the searcher {found.get('searcher', 'unknown')} in "
            f"the kinematic world, {distinct} distinct violations; "
            f"{len(found.get('counterexamples', []))} were shrunk and confirmed in PyBullet, "
            f"{refuted} were not confirmed"
        )
    lines.append("A search looks where violations are: its counts are no estimate of anything.")
    return SearchEvidence(
        runs=sum(int(found.get("tried", 0)) for _, found in results),
        searcher=str(results[0][1].get("searcher", "unknown")),
        lines=tuple(lines),
    )


def slug(name: str) -> str:
    """A stratum's name as a folder's."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name.lower())
    return kept.strip("-")[:60] or "stratum"
