"""What the plan's search found: one folder a stratum, each with a findings.json, read once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import Struct, field

from safety_harness.campaign.plan import Plan
from safety_harness.certification.evidence import SearchSummary
from safety_harness.exceptions import InputError, Place
from safety_harness.report.words import count_words
from safety_harness.scenario.typed_json import read_json, typed

SEARCH, FINDINGS = "search", "findings.json"


class Found(Struct, frozen=True, kw_only=True):
    """A findings.json: runs tried of those asked for, distinct violations, files of counterexamples."""

    tried: int
    budget: int
    seed: int
    searcher: str
    interrupted: bool
    distinct: list[Any]
    unconfirmed: list[Any] = field(name="not confirmed in PyBullet")
    counterexamples: tuple[str, ...]


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
    file, found, problem = where / FINDINGS, None, ""
    try:
        if file.exists():
            found = read_findings(file)
            if (found.budget, found.seed) != (asked, plan.seed):
                found, problem = None, "is another search's than the plan's"
        else:
            problem = "was not made, or failed"
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
        f"{len(found.counterexamples)} were shrunk and confirmed in PyBullet, "
        f"{len(found.unconfirmed)} were not confirmed"
        for stratum, found in known
    ]
    lines += [f"{one.stratum}: the search {one.problem}" for one in searches if one.found is None]
    lines.append("A search looks where violations are: its counts are no estimate of anything.")
    return SearchSummary(
        runs=sum(found.tried for _, found in known), searcher=known[0][1].searcher, lines=tuple(lines)
    )


def _slug(name: str) -> str:
    """A stratum's name as a part of a folder's."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name.lower())
    return kept.strip("-")[:60] or "stratum"
