"""Sentences that compare two campaigns over the same episodes: new violations and lost margins."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from safety_harness.admission.avoiders import option_of
from safety_harness.admission.comparison import reference_for
from safety_harness.base.shipped.contents import is_shipped
from safety_harness.base.whole_file import write_text
from safety_harness.claims.properties.against import SCALES, TOLERANCE, p_words, paired_words
from safety_harness.extensions.assurance.campaign.identity import PlanFile, unpacked
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.merging import PAIRS
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.model import Driver
from safety_harness.scenario.references import file_and_name

_NOT = f"IN ({int(EpisodeOutcome.HOLDS)}, {int(EpisodeOutcome.UNTESTED)})"  # surely not violated
_ONLY_ONE = (
    f"max(a.outcome = {int(EpisodeOutcome.VIOLATED)} AND b.outcome {_NOT}), "
    f"max(b.outcome = {int(EpisodeOutcome.VIOLATED)} AND a.outcome {_NOT})"
)
_LOST = (
    f"SELECT s.name, a.episode, b.margin, a.margin, count(*), max(b.margin - a.margin) {PAIRS} "
    f"WHERE c.sentence = ? AND a.outcome = {int(EpisodeOutcome.HOLDS)} AND b.outcome = a.outcome "
    "AND b.margin - a.margin > ?"
)


def plan_against(ledger: Ledger, reference: str) -> Plan:
    """Return the plan of ``ledger``, but with another avoider or controller.

    The function writes the plan and its files to a folder beside the ledger.

    Args:
        ledger: The open ledger.
        reference: The new avoider or controller. The path of its file is relative to the working directory.

    """
    systems = map(json.loads, ledger.declared.identity.systems)
    driver = next((Driver(sut["controller"]["name"]) for sut in systems if sut.get("avoider") is None), None)
    reference = reference_for(driver, reference) or reference
    return plan_with(ledger.files, reference, ledger.path.parent / f"{ledger.path.stem}-against")


def plan_with(files: Sequence[PlanFile], reference: str, folder: Path) -> Plan:
    """Return the plan in ``files``, but with another avoider or controller.

    The function writes all files to a folder, and reads the plan from there.

    Args:
        files: The files of a plan, beginning with the plan's own file.
        reference: A reference to an avoider, or a ``Driver``.
        folder: The path of the new folder, to whose name the function appends the reference.

    """
    slug = re.sub(r"[^a-z0-9]+", "-", reference.lower()).strip("-")
    file = unpacked(files, folder.with_name(f"{folder.name}-{slug}"))
    key = option_of(reference).removeprefix("--")
    own, name = file_and_name(reference)
    if own and not is_shipped(own):
        own = os.path.relpath(Path(own).expanduser().resolve(), file.parent)
        reference = f"{own}:{name}" if name else own
    line, text = f"{key}: {reference}", file.read_text()
    replaced, count = re.subn(r"(?m)^(avoider|controller):.*$", lambda _: line, text)
    write_text(file, replaced if count else f"{text.rstrip()}\n{line}\n")
    return read_plan(file)


def against_lines(first: Ledger, second: Ledger) -> Iterator[str]:
    """Yield a sentence about each claim that has a smaller margin in ``second`` than in ``first``.

    Then yield a sentence on each new violation. The caller first checks both ledgers with
    ``compare_ledgers``. An episode that lacks a verdict in either ledger is left out.
    """
    path, reference = str(second.path), str(first.path)
    with second.attached(first.path, "first"):
        for sentence, unit in zip(second.declared.claims, second.declared.units, strict=True):
            tolerance = TOLERANCE * SCALES[unit]
            ((stratum, episode, was, now, count, _),) = second.all(_LOST, sentence, tolerance)
            if count:
                worst = f"{unit.margin_text(was)} -> {unit.margin_text(now)} in {stratum}, episode {episode}"
                limit = unit.margin_text(tolerance).removeprefix("+")
                yield f"margin lost by more than {limit}, {sentence}: {count} episodes, the worst {worst}"
        pairs = list(second.all(f"SELECT {_ONLY_ONE} {PAIRS} GROUP BY a.stratum, a.episode"))
    both = sum(a and b for a, b in pairs)
    alone = sum(a for a, _ in pairs) - both, sum(b for _, b in pairs) - both
    yield paired_words(path, reference, *alone, len(pairs), both=both) + p_words(*alone)
