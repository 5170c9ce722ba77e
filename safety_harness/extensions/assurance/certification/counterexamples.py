"""Find distinct violations in the declared runs and in the searches.

The declared runs give the worst violation of each kind, and the searches give their counterexamples. The
search of each stratum has its own folder. The file findings.json in that folder is read only once.

Two violations of a claim are of the same kind if they agree in three things. The three things are the
stratum, the side from which the hand came, and the outcome of the most severe decision.
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
from safety_harness.cell.simulation.worlds import WORLDS, world_option
from safety_harness.extensions.assurance.campaign.episodes import trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import CounterexampleEvidence, SearchSummary
from safety_harness.extensions.assurance.certification.stored import judged_run
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.report.evidence import JudgedRun
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
LARGEST_SCENARIO_BYTES = 2**20  # 1 MiB: a limit of the memory for a damaged or forged report
MOST = 40  # counterexamples with pictures, which take some 0.2 MB each, and 0.3 MB at most
MOST_LINES = 14
# keys of a findings.json before 0.2
EARLIER = {"confirmed_in_pybullet": "confirmed", "not_confirmed_in_pybullet": "not_confirmed"}
MOST_ASKED = 2  # the worst kinds of violation of each claim get an attribution
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
    """A counterexample and its run.

    ``data`` is the stored trace of a declared run, or None if a search found the counterexample.
    """

    shown: CounterexampleEvidence
    run: JudgedRun
    data: bytes | None


@dataclass(eq=False)
class _Kind:
    """The violations of one kind.

    The object has their number, and the worst violating episode whose trace is stored. The episode is None if
    no trace is stored.
    """

    stratum: int
    words: str
    episode: int | None = None
    count: int = 0


def declared_counterexamples(plan: Plan, ledger: Ledger) -> Iterator[Example | str]:
    """Yield the worst violation with a stored trace, for each kind of violation in the declared runs.

    Args:
        plan: The plan of the runs.
        ledger: The ledger with the runs and their stored traces.

    Yields:
        A counterexample, or a text with the reason why the page cannot show it. The text is empty if the
        ledger stored no trace of its kind.

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
            except Exception as error:  # such as a claim that cannot be judged again
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
    """Return the kinds of violations of a claim, beginning with the worst kind.

    ``claim`` is the number of the claim, counted from 0.
    """
    kept = {(stratum, episode) for stratum, episode, _ in ledger.traces()}
    kinds: dict[tuple[int, str], _Kind] = {}
    for stratum, episode, label, _ in ledger.all(_VIOLATIONS, claim, int(EpisodeOutcome.VIOLATED)):
        parts = (label or "no hand").split(", ")
        key = (stratum, f"{parts[0]}, {parts[-1]}")
        kind = kinds.setdefault(key, _Kind(*key))
        kind.count += 1
        if kind.episode is None and (stratum, episode) in kept:
            kind.episode = episode
    return list(kinds.values())


def _circumstances(run: JudgedRun) -> tuple[str, ...]:
    """Return at most ``MOST_LINES`` lines on the circumstances of the decisions in ``run``."""
    try:
        lines = circumstances(run.trace)
    except InputError:
        return ("its place relative to the training data is unknown: its network is missing",)
    except Exception as error:  # a missing line is no reason to lose the report
        return (f"its place relative to the training data is unknown: {described(error)}",)
    more = len(lines) - MOST_LINES
    return tuple(lines[:MOST_LINES]) + ((f"and {more} more decisions",) if more > 0 else ())


SEARCH, FINDINGS = "search", "findings.json"


class FaultsFound(Struct, frozen=True):
    """The causes of the violations that a search found, in one line."""

    words: str


class Found(Struct, frozen=True, kw_only=True):
    """The content of a findings.json.

    The file has the tried and the requested runs, the distinct violations and the counterexample files.
    """

    tried: int
    budget: int
    seed: int
    searcher: str
    interrupted: bool
    distinct: list[Any]
    confirmed: int
    confirmed_in: tuple[str, ...]
    unconfirmed: list[Any] = field(name="not_confirmed")
    counterexamples: tuple[str, ...]
    attribution: FaultsFound | None = None
    searched_in: str = "the kinematic world"

    @property
    def confirmed_words(self) -> str:
        """A phrase with the worlds that confirm the counterexamples.

        The phrase is empty if no counterexample is confirmed.
        """
        return f" and confirmed in {' and '.join(self.confirmed_in)}" if self.confirmed else ""


@dataclass(frozen=True, kw_only=True)
class Searched:
    """The search of one stratum.

    Args:
        stratum: The name of the stratum.
        folder: The folder with the findings and the counterexamples.
        asked: The number of runs that the plan asks for.
        found: The findings, or None if the file is missing, cannot be read or belongs to another search.
        problem: The reason why ``found`` is None.

    """

    stratum: str
    folder: Path
    asked: int
    found: Found | None
    problem: str = ""

    @property
    def complete(self) -> bool:
        """True if the search finished without an interruption."""
        return self.found is not None and not self.found.interrupted


def read_findings(path: Path) -> Found:
    """Return the findings in ``path``, a file that ``fuzz`` wrote.

    Raises:
        InputError: ``fuzz`` did not write the file. The error states the wrong field.

    """
    stored = read_json(path, "the findings of a search")
    if isinstance(stored, dict) and EARLIER.keys() <= stored.keys():
        stored |= {now: stored[then] for then, now in EARLIER.items()} | {"confirmed_in": ["PyBullet"]}
    findings = typed(stored, Found, path, further_fields=True)
    if not 0 <= findings.tried <= findings.budget:
        place, got = Place(file=path, field="tried"), str(findings.tried)
        raise InputError(place=place, expected=f"0 to {findings.budget} runs", got=got)
    for k, name in enumerate(findings.counterexamples):
        if Path(name).name != name or "\0" in name:
            place = Place(file=path, field=f"counterexamples[{k}]")
            raise InputError(place=place, expected="the name of a file beside it", got=repr(name)[:60])
    return findings


def searches_of(plan: Plan, folder: Path) -> tuple[Searched, ...]:
    """Return the searches of all strata that receive search runs, in the order of ``plan``.

    ``folder`` is the report's folder. The search runs are divided equally among the strata. If a remainder is
    left, each of the first strata receives one of the remaining runs.
    """
    each, more = divmod(plan.search_runs, len(plan.strata))
    shares = [each + (place < more) for place in range(len(plan.strata))]
    return tuple(_searched(plan, folder, place, share) for place, share in enumerate(shares) if share)


def _searched(plan: Plan, folder: Path, place: int, share: int) -> Searched:
    """Return the search of stratum number ``place``.

    The result has the findings of the search if they belong to this plan.
    """
    stratum = plan.strata[place].name
    where = folder / SEARCH / f"{place + 1}-{_slug(stratum)}"
    file, findings, problem = where / FINDINGS, None, "was not made, or failed"
    try:
        if file.exists():
            findings, problem = read_findings(file), ""
            wanted = (share, plan.seed, str(plan.search_world))
            if (findings.budget, findings.seed, findings.searched_in) != wanted:
                findings, problem = None, "is another search's than the plan's"
    except InputError as error:
        problem = f"cannot be read: {error.place.field or 'the file'}: expected {error.expected}"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    return Searched(stratum=stratum, folder=where, asked=share, found=findings, problem=problem)


def search_evidence(searches: tuple[Searched, ...]) -> SearchSummary | None:
    """Return a summary of the ``searches`` that have findings.

    Return None if no findings are known, for example because the plan requires no search.
    """
    known = [(item.stratum, item.found) for item in searches if item.found is not None]
    if not known:
        return None
    lines = [
        f"{stratum}: {search.tried} runs of the searcher {search.searcher} in {search.searched_in}, "
        f"{count_words(len(search.distinct), 'group of violations', 'groups of violations')}; "
        f"{count_words(len(search.counterexamples), 'was', 'were')} shrunk"
        f"{search.confirmed_words}, "
        f"{count_words(len(search.unconfirmed), 'was', 'were')} not confirmed"
        for stratum, search in known
    ]
    lines += [f"{item.stratum}: the search {item.problem}" for item in searches if item.found is None]
    lines += [f"{stratum}: {search.attribution.words}" for stratum, search in known if search.attribution]
    lines.append("A search looks where violations are: its counts are no estimate of anything.")
    return SearchSummary(
        runs=sum(search.tried for _, search in known), searcher=known[0][1].searcher, lines=tuple(lines)
    )


def _slug(name: str) -> str:
    """Return a stratum's ``name`` in a form that the name of a folder may contain."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name.lower())
    return kept.strip("-")[:60] or "stratum"


def searched_counterexamples(
    plan: Plan, searches: Sequence[Searched], folder: Path
) -> Iterator[Example | str]:
    """Yield the counterexamples of the searches: minimised, confirmed and explained scenarios with traces.

    Args:
        plan: The plan of the report.
        searches: The searches of its strata.
        folder: The report's folder.

    Yields:
        A counterexample, or a text with the reason why the page cannot show it.

    """
    sentences = [claim.sentence for claim in plan.claims]
    for search in searches:
        for name in search.found.counterexamples if search.found else ():
            file = search.folder / name
            trace = file.with_suffix(".trace")
            try:
                run = judged_run(load_trace(trace))
                refuse_not_simulated(run.trace, trace)
                if run.trace.provenance.world not in {
                    plan.search_world.name,
                    *(item.name for item in WORLDS),
                }:
                    raise ScenarioError.of_file(trace, "a trace of the searched world or ours", "another")
                if _acted(read_scenario(file)) != _acted(run.trace.scenario):
                    raise ScenarioError.of_file(file, "its trace's scenario", "another than its trace has")
                sentence, lines = _comments_of(file)
            except InputError as error:
                got = "no trace" if not trace.is_file() else error.got
                yield f"{search.stratum}: the search's {name} cannot be shown: {got}"
                continue
            yield _example(
                run,
                sentences.index(sentence) if sentence in sentences else None,
                sentence,
                origin=f"the search of {search.stratum}, shrunk",
                trace=trace.relative_to(folder).as_posix(),
                scenario=file.relative_to(folder).as_posix(),
                lines=lines[:MOST_LINES],
            )


def _acted(scenario: Scenario) -> str:
    """Return ``scenario`` as text.

    The text has no title, description and claims, because a search changes these parts.
    """
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
    """Return a counterexample with its margin and its ``replay`` command.

    The function ``numbered`` sets the number of the counterexample.
    """
    index = run.under_claim(sentence).about
    shown = CounterexampleEvidence(
        number=0,
        claim=None if claim is None else claim + 1,
        sentence=sentence,
        origin=origin,
        independent=data is not None,
        like_it=like_it,
        margin="\u2013" if index is None else margin_words(run.evaluations[index]),
        scenario_file=scenario,
        trace_file=trace,
        command=shlex.join(["safety-harness", "replay", trace, *world_option(run.trace.provenance.world)]),
        lines=tuple(lines),
    )
    return Example(shown, run, data)


def told_whose_fault(plan: Plan, met: Sequence[Example | str]) -> tuple[Example | str, ...]:
    """Return ``met``, with an attribution added to the worst declared counterexamples of each claim.

    The attribution runs the scenarios again. Like the runs, the attribution executes the programs to which
    the plan refers. The attribution covers ``MOST_ASKED`` counterexamples of each claim. Counterexamples of a
    search already have an attribution.
    """
    attribution = SearchAttribution()
    counts: Counter[int] = Counter()
    examples: list[Example | str] = []
    for item in met:
        claim = item.shown.claim if isinstance(item, Example) and item.shown.independent else None
        if isinstance(item, Example) and claim is not None and counts[claim] < MOST_ASKED:
            counts[claim] += 1
            attributions = attribution.explain(item.run.trace.scenario, plan.claims[claim - 1].claim)
            item = with_fault(item, attributions.lines)
        examples.append(item)
    return tuple(examples)


def with_fault(met: Example, lines: Sequence[str]) -> Example:
    """Return the counterexample ``met`` with the attribution ``lines``.

    The attribution follows the first line, which states the kind.
    """
    return replace(met, shown=replace(met.shown, lines=(*met.shown.lines[:1], *lines, *met.shown.lines[1:])))


def numbered(met: Sequence[Example | str]) -> tuple[Example, ...]:
    """Return the counterexamples in ``met``, without the texts, and number them from 1."""
    shown = [item for item in met if isinstance(item, Example)]
    return tuple(replace(item, shown=replace(item.shown, number=k)) for k, item in enumerate(shown, start=1))


def write_traces(examples: Sequence[Example], folder: Path) -> None:
    """Write the traces of the declared ``examples`` below ``folder``, and remove earlier traces of this kind.

    Raises:
        OSError: A trace cannot be written.

    """
    keep = {example.shown.trace_file for example in examples}
    for file in (folder / FOLDER).glob("claim-*-stratum-*-run-*.trace"):
        if file.relative_to(folder).as_posix() not in keep:
            file.unlink()
    for example in examples:
        if example.data is not None:
            file = folder / example.shown.trace_file
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(example.data)


def _comments_of(file: Path) -> tuple[str, list[str]]:
    """Return the violated claim and the explanation from the comments in a counterexample's file.

    The explanation begins below the first empty comment line.
    """
    place = Place(file=file)
    data = read_bytes(file, most=LARGEST_SCENARIO_BYTES, place=place, error=ScenarioError)
    lines = decode(data, most=LARGEST_SCENARIO_BYTES, file=file, error=ScenarioError).splitlines()
    head = [line[1:].strip() for line in lines if line.startswith("#")]
    sentence = next((line.removeprefix(TO).strip() for line in head if line.startswith(TO)), "something")
    return sentence, [line for line in head[head.index("") + 1 :] if line] if "" in head else []
