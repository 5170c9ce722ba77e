"""Distinct violations: the worst of each kind among the declared runs, and those that a search found.

A search has one folder a stratum, each with a findings.json, read once.

Violations of a claim are of one kind if the hand came from the same side, the gravest decision had the same
outcome and the stratum is the same.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import Struct, field

from safety_harness.base.exceptions import InputError, Place, ScenarioError, described
from safety_harness.extensions.assurance.campaign.episodes import trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import CounterexampleEvidence, SearchSummary
from safety_harness.extensions.assurance.certification.stored import judged_run
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.search_attribution import SearchAttribution
from safety_harness.report.words import count_words, margin_words
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.typed_json import read_json, typed
from safety_harness.scenario.write import write_scenario
from safety_harness.search.counterexample import circumstances
from safety_harness.trace.store import load_trace
from safety_harness.trace.unmeasured import refuse_not_simulated

FOLDER = "counterexamples"
LARGEST_SCENARIO_BYTES = 2**20
MOST = 40  # with pictures on the page: drawings and a replay take some 0.2 MB, 0.3 at most
MOST_LINES = 14
MOST_ASKED = 2  # kinds of violation of each claim, the worst, of which it is told whose fault they are
FAULT = "whose fault: "
TO = "A counterexample to:"

_VIOLATIONS = (
    "SELECT e.stratum, e.episode, c.words, j.margin FROM judgement j "
    "JOIN episode e ON e.stratum = j.stratum AND e.episode = j.episode "
    "LEFT JOIN cell c ON c.id = e.cell WHERE j.claim = ? AND j.outcome = ? "
    "ORDER BY j.margin, e.stratum, e.episode"
)


@dataclass(frozen=True, eq=False)
class Example:
    """A counterexample and its run; ``data`` is the trace of a declared one."""

    shown: CounterexampleEvidence
    run: JudgedRun
    data: bytes | None


@dataclass(eq=False)
class _Kind:
    """Violations that are one thing to a reader, how many there are, and the worst whose trace is kept."""

    stratum: int
    words: str
    episode: int | None = None
    count: int = 0


def declared_counterexamples(plan: Plan, ledger: Ledger) -> Iterator[Example | str]:
    """Of the plan's own runs: of each kind the worst whose trace is kept.

    Text is of one that cannot be shown: why, or nothing where no trace of its kind was kept.
    """
    for number, claim in enumerate(plan.claims):
        for kind in _kinds(ledger, number):
            data = None if kind.episode is None else ledger.trace(kind.stratum, kind.episode)
            stratum = plan.strata[kind.stratum].name
            if data is None:
                yield ""
                continue
            try:
                run = judged_run(trace_of(plan, kind.stratum, data))
            except Exception as error:  # a claim that cannot be judged again, say
                why = error.got if isinstance(error, InputError) else described(error)
                yield f"{stratum}, run {kind.episode}: its stored trace cannot be read: {why}"
                continue
            name = f"claim-{number + 1}-stratum-{kind.stratum + 1}-run-{kind.episode}.trace"
            yield _example(
                run,
                number,
                claim.sentence,
                origin=f"declared run {kind.episode} of {stratum}",
                like_it=kind.count,
                trace=f"{FOLDER}/{name}",
                lines=(f"kind: {kind.words}", *_circumstances(run)),
                data=data,
            )


def _kinds(ledger: Ledger, claim: int) -> list[_Kind]:
    """The worst first."""
    kept = {(stratum, episode) for stratum, episode, _ in ledger.traces()}
    found: dict[tuple[int, str], _Kind] = {}
    for stratum, episode, words, _ in ledger.all(_VIOLATIONS, claim, int(EpisodeOutcome.VIOLATED)):
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
    except InputError:
        return ("where it lies relative to the training data is not known: its network is not there",)
    except Exception as error:  # no reason to lose the report
        return (f"where it lies relative to the training data is not known: {described(error)}",)
    more = len(lines) - MOST_LINES
    return tuple(lines[:MOST_LINES]) + ((f"and {more} more decisions",) if more > 0 else ())


SEARCH, FINDINGS = "search", "findings.json"


class FaultsFound(Struct, frozen=True):
    """Whose fault the violations of a search are, in one line."""

    words: str


class Found(Struct, frozen=True, kw_only=True):
    """A findings.json: runs tried of those asked for, distinct violations, files of counterexamples."""

    tried: int
    budget: int
    seed: int
    searcher: str
    interrupted: bool
    distinct: list[Any]
    confirmed: int = field(name="confirmed_in_pybullet")
    unconfirmed: list[Any] = field(name="not_confirmed_in_pybullet")
    counterexamples: tuple[str, ...]
    attribution: FaultsFound | None = None


@dataclass(frozen=True, kw_only=True)
class Searched:
    """The search of one stratum: runs ``asked`` for, and what was found; ``problem`` says why nothing was."""

    stratum: str
    folder: Path
    asked: int
    found: Found | None
    problem: str = ""

    @property
    def complete(self) -> bool:
        """Was it made as the plan asks, to its end?"""
        return self.found is not None and not self.found.interrupted


def read_findings(path: Path) -> Found:
    """InputError, naming the field, for what fuzz did not write."""
    found = typed(read_json(path, "the findings of a search"), Found, path, others=True)
    if not 0 <= found.tried <= found.budget:
        place, got = Place(file=path, field="tried"), str(found.tried)
        raise InputError(place=place, expected=f"0 to {found.budget} runs", got=got)
    for k, name in enumerate(found.counterexamples):
        if Path(name).name != name or "\0" in name:
            place = Place(file=path, field=f"counterexamples[{k}]")
            raise InputError(place=place, expected="the name of a file beside it", got=repr(name)[:60])
    return found


def searches_of(plan: Plan, folder: Path) -> tuple[Searched, ...]:
    """One for each stratum that the plan's search goes to, in the plan's order."""
    each, more = divmod(plan.search_runs, len(plan.strata))
    shares = [each + (place < more) for place in range(len(plan.strata))]
    return tuple(_searched(plan, folder, place, asked) for place, asked in enumerate(shares) if asked)


def _searched(plan: Plan, folder: Path, place: int, asked: int) -> Searched:
    stratum = plan.strata[place].name
    where = folder / SEARCH / f"{place + 1}-{_slug(stratum)}"
    file, found, problem = where / FINDINGS, None, "was not made, or failed"
    try:
        if file.exists():
            found, problem = read_findings(file), ""
            if (found.budget, found.seed) != (asked, plan.seed):
                found, problem = None, "is another search's than the plan's"
    except InputError as error:
        problem = f"cannot be read: {error.place.field or 'the file'}: expected {error.expected}"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    return Searched(stratum=stratum, folder=where, asked=asked, found=found, problem=problem)


def search_evidence(searches: tuple[Searched, ...]) -> SearchSummary | None:
    """What was hunted for and how; None where the plan asks for no search or nothing is known of any."""
    known = [(one.stratum, one.found) for one in searches if one.found is not None]
    if not known:
        return None
    lines = [
        f"{stratum}: {found.tried} runs of the searcher {found.searcher} in the kinematic world, "
        f"{count_words(len(found.distinct), 'group of violations', 'groups of violations')}; "
        f"{count_words(len(found.counterexamples), 'was', 'were')} shrunk"
        f"{' and confirmed in PyBullet' * bool(found.confirmed)}, "
        f"{count_words(len(found.unconfirmed), 'was', 'were')} not confirmed"
        for stratum, found in known
    ]
    lines += [f"{one.stratum}: the search {one.problem}" for one in searches if one.found is None]
    lines += [f"{stratum}: {found.attribution.words}" for stratum, found in known if found.attribution]
    lines.append("A search looks where violations are: its counts are no estimate of anything.")
    return SearchSummary(
        runs=sum(found.tried for _, found in known), searcher=known[0][1].searcher, lines=tuple(lines)
    )


def _slug(name: str) -> str:
    """A stratum's name as a part of a folder's."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name.lower())
    return kept.strip("-")[:60] or "stratum"


def searched_counterexamples(
    plan: Plan, searches: Sequence[Searched], folder: Path
) -> Iterator[Example | str]:
    """What the search wrote below ``folder``: shrunk, confirmed and explained scenario files with traces.

    Text is why one cannot be shown.
    """
    sentences = [claim.sentence for claim in plan.claims]
    for one in searches:
        for name in one.found.counterexamples if one.found else ():
            file = one.folder / name
            trace = file.with_suffix(".trace")
            try:
                run = judged_run(load_trace(trace))
                refuse_not_simulated(run.trace, trace)
                if _acted(read_scenario(file)) != _acted(run.trace.scenario):
                    raise ScenarioError.of_file(file, "its trace's scenario", "another than its trace has")
                sentence, lines = _told(file)
            except InputError as error:
                got = "no trace" if not trace.is_file() else error.got
                yield f"{one.stratum}: the search's {name} cannot be shown: {got}"
                continue
            yield _example(
                run,
                sentences.index(sentence) if sentence in sentences else None,
                sentence,
                origin=f"the search of {one.stratum}, shrunk",
                trace=trace.relative_to(folder).as_posix(),
                scenario=file.relative_to(folder).as_posix(),
                lines=lines[:MOST_LINES],
            )


def _acted(scenario: Scenario) -> str:
    """The text of a scenario but for its title and claims, of which a counterexample has its own."""
    return write_scenario(replace(scenario, title="-", about="", claims=()))


def _example(
    run: JudgedRun,
    claim: int | None,
    sentence: str,
    *,
    origin: str,
    trace: str,
    lines: Sequence[str],
    like_it: int = 1,
    scenario: str = "",
    data: bytes | None = None,
) -> Example:
    of = run.under(sentence).about
    shown = CounterexampleEvidence(
        number=0,
        claim=None if claim is None else claim + 1,
        sentence=sentence,
        origin=origin,
        independent=data is not None,
        like_it=like_it,
        margin="\u2013" if of is None else margin_words(run.evaluations[of]),
        scenario_file=scenario,
        trace_file=trace,
        command=shlex.join(["safety-harness", "replay", trace]),
        lines=tuple(lines),
    )
    return Example(shown, run, data)


def told_whose_fault(plan: Plan, met: Sequence[Example | str]) -> tuple[Example | str, ...]:
    """The worst declared ones of each claim with what is said of searched ones: whose fault they are.

    It executes what the plan names, as the runs did.
    """
    attribution = SearchAttribution()
    asked: Counter[int] = Counter()
    told: list[Example | str] = []
    for one in met:
        claim = one.shown.claim if isinstance(one, Example) and one.shown.independent else None
        if isinstance(one, Example) and claim is not None and asked[claim] < MOST_ASKED:
            asked[claim] += 1
            lines = attribution.explain(one.run.trace.scenario, plan.claims[claim - 1].claim)
            one = with_fault(one, lines)
        told.append(one)
    return tuple(told)


def with_fault(one: Example, lines: Sequence[str]) -> Example:
    """With these lines below the kind that it is of."""
    return replace(one, shown=replace(one.shown, lines=(*one.shown.lines[:1], *lines, *one.shown.lines[1:])))


def numbered(met: Sequence[Example | str]) -> tuple[Example, ...]:
    """With numbers from 1, those that cannot be shown left out."""
    shown = [one for one in met if isinstance(one, Example)]
    return tuple(replace(one, shown=replace(one.shown, number=k)) for k, one in enumerate(shown, start=1))


def write_traces(examples: Sequence[Example], folder: Path) -> None:
    """The declared ones' traces below ``folder``, in place of all that were there.  Raises OSError."""
    keep = {one.shown.trace_file for one in examples}
    for file in (folder / FOLDER).glob("claim-*-stratum-*-run-*.trace"):
        if file.relative_to(folder).as_posix() not in keep:
            file.unlink()
    for one in examples:
        if one.data is not None:
            file = folder / one.shown.trace_file
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(one.data)


def _told(file: Path) -> tuple[str, list[str]]:
    """What a counterexample's file says in its comments: to what it is one, and below the gap why."""
    place = Place(file=file)
    data = read_bytes(file, most=LARGEST_SCENARIO_BYTES, place=place, error=ScenarioError)
    lines = decode(data, most=LARGEST_SCENARIO_BYTES, file=file, error=ScenarioError).splitlines()
    head = [line[1:].strip() for line in lines if line.startswith("#")]
    told = next((line.removeprefix(TO).strip() for line in head if line.startswith(TO)), "something")
    return told, [line for line in head[head.index("") + 1 :] if line] if "" in head else []
