"""The changes from an evidence report to a later report: regressions, and evidence that still applies.

These are regressions:

- A claim lost the status SHOWN in a stratum, or a claim with this status is gone.
- The confidence is lower.
- A target is larger, and the claim no longer meets the earlier target.
- A claim was not SHOWN and not ESTIMATED, and the later plan omits this claim or shows it in another space.
- A finding is new.
- A proof is gone.
- A hazard met its hourly limit and no longer meets it.
- The data show that a violation probability is larger. If both reports ran the same episodes, the interval of
  the paired difference lies above zero. If the episodes differ, the intervals of the two reports are
  disjoint.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from safety_harness.base.exceptions import InputError, LedgerError, Place, StatisticsError
from safety_harness.claims.properties.catalogue import in_words_of_today
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.signals.separation import WALKING_MPS
from safety_harness.extensions.assurance.campaign.identity import SYSTEM, Identity, edition_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.merging import began_at, compare_ledgers, refuse_itself
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.delta_parts import (
    NONE,
    PartChange,
    both,
    parts_changed,
    proofs_in,
)
from safety_harness.extensions.assurance.certification.evidence import (
    SEVERITY,
    Bound,
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    read_evidence,
)
from safety_harness.extensions.assurance.certification.folder import JSON, read_manifest
from safety_harness.extensions.assurance.certification.verdicts import at_least, at_most, percent
from safety_harness.extensions.assurance.certification.verify_files import check_files
from safety_harness.scenario.typed_json import plain

FORMAT = "safety-harness delta 1"


@dataclass(frozen=True)
class ClaimChange:
    """A claim whose status or target differs.

    A status or target is None if the plan does not have the claim. ``stratum`` is empty if the status refers
    to the claim over all strata.
    """

    sentence: str
    stratum: str
    before: ClaimStatus | None
    after: ClaimStatus | None
    target_before: float | None
    target_after: float | None


@dataclass(frozen=True)
class BoundChange:
    """A bound that differs between two reports.

    ``worse`` is true if the data show that the bound got worse. ``better`` is true if the data show that the
    bound got better. ``how`` states the method of comparison. If the data show no change, ``worse`` and
    ``better`` are both false.
    """

    sentence: str
    stratum: str
    before: Bound | None
    after: Bound | None
    worse: bool
    better: bool
    how: str


@dataclass(frozen=True)
class CarriedPart:
    """A part of the earlier evidence, and whether it also applies to the later system.

    ``why`` states the reason.
    """

    what: str
    carries: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class EvidenceDelta:
    """The comparison of two evidence reports.

    ``before`` and ``after`` each have the name of a report's folder and the root hash of the report's rows.
    ``bases`` are the basis lines of both reports. If a finding is still open and the numbers in its text have
    changed, ``reworded`` has the pair (earlier text, later text).
    """

    format: str
    before: tuple[str, str]
    after: tuple[str, str]
    bases: tuple[str, str]
    regressions: tuple[str, ...]
    parts: tuple[PartChange, ...]
    claims: tuple[ClaimChange, ...]
    bounds: tuple[BoundChange, ...]
    opened: tuple[str, ...]
    closed: tuple[str, ...]
    reworded: tuple[tuple[str, str], ...]  # findings that are still open, with other numbers
    carried: tuple[CarriedPart, ...]

    @property
    def empty(self) -> bool:
        """True if the two reports do not differ."""
        return not (self.parts or self.claims or self.bounds or self.opened or self.closed or self.reworded)

    @property
    def line(self) -> str:
        """The result of the comparison in one sentence."""
        if self.empty:
            return "nothing changed"
        if self.regressions:
            return f"{len(self.regressions)} got worse since {self.before[0]}"
        return f"nothing got worse since {self.before[0]}"

    def as_text(self) -> str:
        """Return the comparison as JSON."""
        return json.dumps(plain(self), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


@dataclass(frozen=True, eq=False)
class EarlierReport:
    """A finished report whose files match its manifest."""

    folder: Path
    evidence: Evidence

    @classmethod
    def read(cls, folder: Path) -> EarlierReport:
        """Read the report in ``folder``, and check its files against the manifest.

        Raises:
            InputError: The folder is no report, its runs are not finished, or a file was altered.

        """
        hashes = read_manifest(folder)
        if faults := check_files(folder, hashes).faults:
            expected = "the folder of a report as certify wrote it"
            hint = f"safety-harness verify {folder} checks all of it"
            raise InputError(place=Place(file=folder), expected=expected, got="; ".join(faults), hint=hint)
        evidence = read_evidence(folder / JSON)
        if evidence.interrupted:
            raise InputError(
                place=Place(file=folder), expected="a finished report", got="one with runs missing"
            )
        return cls(folder, evidence)


def delta_of(earlier: EarlierReport, later: EarlierReport) -> EvidenceDelta:
    """Return all changes from the ``earlier`` report to the ``later`` report.

    Raises:
        InputError: A ledger cannot be read, both reports have the same runs, or ``later`` began first.

    """
    with ExitStack() as stack:
        reports = (earlier, later)
        first, second = (
            stack.enter_context(Ledger.open(report.folder / LEDGER, alone=True)) for report in reports
        )
        _refuse_order(earlier, first, second)
        return delta_between(
            earlier.evidence,
            later.evidence,
            names=(earlier.folder.resolve().name, later.folder.resolve().name),
            identities=(first.declared.identity, second.declared.identity),
            paired=_paired(first, second),
        )


def _refuse_order(earlier: EarlierReport, first: Ledger, second: Ledger) -> None:
    """Raise InputError if both ledgers hold the same runs, or if the earlier report's runs began later."""
    refuse_itself(first, second)
    was, now = (began_at(ledger)[-1:] for ledger in (first, second))
    if was > now:
        expected, got = "the earlier report first", f"runs that began at {was[0]}, before which others began"
        raise InputError(place=Place(file=earlier.folder), expected=expected, got=f"{got} at {''.join(now)}")


Paired = dict[tuple[str, str], tuple[float, float, float]]


def delta_between(
    old: Evidence,
    new: Evidence,
    *,
    names: tuple[str, str],
    identities: tuple[Identity, Identity],
    paired: Paired,
) -> EvidenceDelta:
    """Compare the evidence of two reports.

    Args:
        old: The evidence of the earlier report.
        new: The evidence of the later report.
        names: The names of the two folders.
        identities: The inputs on which the runs of each report depend.
        paired: For each (claim, stratum), the interval of the difference in the violation probability, later
            minus earlier, as (lower end, upper end, confidence). If there is no entry, the two intervals of
            the claim are compared instead.

    Returns:
        The comparison.

    """
    if len(set(map(edition_of, identities))) > 1:
        old, new = (
            _named(report, edition_of(own)) for report, own in zip((old, new), identities, strict=True)
        )
    bounds = tuple(_bounds(old, new, paired))
    unasked = dict(_unasked(old, new))
    opened, closed, reworded = _findings(old, new, unasked)
    return EvidenceDelta(
        format=FORMAT,
        before=(names[0], old.record.rows_sha256),
        after=(names[1], new.record.rows_sha256),
        bases=(f"{names[0]}: {old.basis}", f"{names[1]}: {new.basis}"),
        regressions=(
            *_lost(old, new),
            *unasked.values(),
            *_loosened(old, new),
            *(_worse_words(report) for report in bounds if report.worse),
            *_unproven(old, new),
            *_unrated(old, new),
            *(f"a finding was opened: {text}" for text in opened),
        ),
        parts=tuple(parts_changed(old, new)),
        claims=tuple(_claims(old, new)),
        bounds=bounds,
        opened=opened,
        closed=closed,
        reworded=reworded,
        carried=tuple(_carried(old, new, *identities)),
    )


def _named(evidence: Evidence, edition: int) -> Evidence:
    """Return ``evidence`` with its claims in the words of the present catalogue.

    In edition 1, protective separation assumed that hands move at WALKING_MPS.
    """
    kept = ProtectiveSeparation().sentence
    now = ProtectiveSeparation(hand_speed_mps=WALKING_MPS).sentence

    def today(claim: ClaimEvidence) -> ClaimEvidence:
        separation = edition <= 1 and claim.sentence == kept
        return replace(claim, sentence=now if separation else in_words_of_today(claim.sentence))

    return replace(evidence, claims=tuple(map(today, evidence.claims)))


def _claims_by(evidence: Evidence) -> dict[str, ClaimEvidence]:
    return {claim.sentence: claim for claim in evidence.claims}


def _claims(old: Evidence, new: Evidence) -> Iterator[ClaimChange]:
    """Yield each claim whose target or status differs.

    The status is compared in each stratum, and over all strata.
    """
    targets = [{claim.sentence: claim.target for claim in each.claims} for each in (old, new)]
    earlier, later = (_standings(each) for each in (old, new))
    for sentence, stratum in dict.fromkeys([*earlier, *later]):
        key = (sentence, stratum)
        was, now = (earlier.get(key), targets[0].get(sentence)), (later.get(key), targets[1].get(sentence))
        if was[0] is not now[0] or (was != now and not stratum):
            yield ClaimChange(sentence, stratum, was[0], now[0], was[1], now[1])


def _standings(evidence: Evidence) -> dict[tuple[str, str], ClaimStatus]:
    """Return the status of each claim in each stratum, and over all strata.

    The key of a status over all strata has an empty stratum.
    """
    whole = {(claim.sentence, ""): claim.standing for claim in evidence.claims}
    return whole | {key: result.standing for key, result in _outcomes(evidence).items()}


def _outcomes(evidence: Evidence) -> dict[tuple[str, str], ClaimResult]:
    return {(claim.sentence, row.stratum): row for claim in evidence.claims for row in claim.outcomes}


def _lost(old: Evidence, new: Evidence) -> Iterator[str]:
    """Yield each claim that lost the status SHOWN, in a stratum or over the whole plan."""
    outcomes, claims = _outcomes(new), _claims_by(new)
    listed = set()
    for (sentence, stratum), was in _outcomes(old).items():
        now = outcomes.get((sentence, stratum))
        if was.standing is ClaimStatus.SHOWN and (now is None or now.standing is not ClaimStatus.SHOWN):
            listed.add(sentence)
            gone = f"the {'stratum' if sentence in claims else 'claim'} is not in the plan any more"
            state = gone if now is None else f"{now.standing.value}: {now.why}"
            yield f"{sentence}, {stratum}: shown before, now {state}"
    for sentence, claim, later in both(_claims_by(old), claims):
        lost = claim and claim.standing is ClaimStatus.SHOWN is not (later and later.standing)
        # A claim that is listed for a stratum is not listed for the whole plan again.
        if lost and later and sentence not in listed:
            yield f"{sentence}: shown before, now {later.standing.value}: {later.why}"


def _unasked(old: Evidence, new: Evidence) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield each claim that was not shown before and that the later plan avoids.

    Each item consists of the pair (claim, stratum) and the reason. In the earlier report, the claim was not
    SHOWN and not ESTIMATED. The later plan lacks the claim or the stratum, or shows the claim in another
    space.
    """
    later, claims = _outcomes(new), _claims_by(new)
    spaces = [{stratum.name: stratum.space_sha256 for stratum in each.strata} for each in (old, new)]
    for key, was in _outcomes(old).items():
        now = later.get(key)
        if was.standing in (ClaimStatus.SHOWN, ClaimStatus.ESTIMATED):
            continue
        why = f"the {'stratum' if key[0] in claims else 'claim'} is not in the plan"
        if now is not None:
            if now.standing is not ClaimStatus.SHOWN or spaces[0].get(key[1]) == spaces[1].get(key[1]):
                continue
            why = "its space changed"
        yield key, f"{', '.join(key)}: {was.standing.value} before, and dropped since: {why}"


def _loosened(old: Evidence, new: Evidence) -> Iterator[str]:
    """Yield a text if the confidence is lower.

    Also yield a text for each larger target if the claim no longer meets its earlier target.
    """
    if new.plan.confidence < old.plan.confidence:
        lower, higher = percent(new.plan.confidence), percent(old.plan.confidence)
        yield f"the bounds hold with {lower} confidence, {higher} before"
    claims = _claims_by(old)
    for claim in new.claims:
        target = claims[claim.sentence].target if claim.sentence in claims else None
        for row in claim.outcomes:
            was = _outcomes(old).get((claim.sentence, row.stratum))
            kept = row.bound is not None and target is not None and row.bound.upper <= target
            if was and was.standing is row.standing is ClaimStatus.SHOWN and target and not kept:
                yield f"{claim.sentence}, {row.stratum}: shown for a larger target, not for {percent(target)}"


def _paired(first: Ledger, second: Ledger) -> Paired:
    """Return the interval and the confidence of each paired difference.

    The result is empty if the ledgers have different episodes.
    """
    try:
        compared = compare_ledgers(first, second)
    except (LedgerError, StatisticsError):
        return {}
    return {(row.claim, row.stratum): (row.low, row.high, row.confidence) for row in compared}


def _bounds(old: Evidence, new: Evidence, paired: Paired) -> Iterator[BoundChange]:
    """Yield each bound that differs, and whether the data show that it got worse or better."""
    earlier, later = _outcomes(old), _outcomes(new)
    for key in dict.fromkeys([*earlier, *later]):
        was, now = (results[key].bound if key in results else None for results in (earlier, later))
        if was == now:
            continue
        worse = better = False
        how = "a bound in one report only"
        # The same episodes in both reports: their pairs cancel what the episodes have in common.
        if was and now and key in paired:
            low, high, confidence = paired[key]
            worse, better = low > 0.0, high < 0.0
            how = (
                f"the difference, paired by episode, is {100 * low:+.3g} % to {100 * high:+.3g} %, "
                f"{100 * confidence:.4g} % alone"
            )
        elif was and now:
            worse, better = now.lower > was.upper, now.upper < was.lower
            how = "other episodes: a comparison of the two intervals"
        yield BoundChange(*key, was, now, worse, better, how)


def _worse_words(row: BoundChange) -> str:
    """Return the sentence on a bound that got worse."""
    return (
        f"{row.sentence}, {row.stratum}: {interval(row.before)} before, {interval(row.after)} now; {row.how}"
    )


def interval(bound: Bound | None) -> str:
    """Return a text with both ends of ``bound``."""
    return NONE if bound is None else f"{at_least(bound.lower)} to {at_most(bound.upper)}"


def _unproven(old: Evidence, new: Evidence) -> Iterator[str]:
    """Yield each claim that was proven before and is not proven now."""
    for name, was, now in both(proofs_in(old), proofs_in(new)):
        if was == "proven" != now:
            yield f"{name}: proven before, now {now or 'no proof is given'}"


def _unrated(old: Evidence, new: Evidence) -> Iterator[str]:
    """Yield each hazard whose rates met their limit before and do not meet it now."""
    if old.plan.model_only:
        return
    earlier, later = ({hazard.name: hazard for hazard in each.hazards} for each in (old, new))
    for name, was, now in both(earlier, later):
        if was and was.met and not (now and now.met and not new.plan.model_only):
            state = "not shown to be now" if now else "the hazard is not in the plan any more"
            yield f"{name}: rare enough before, {state}"


_QUOTED_OR_NUMBER = re.compile(r"('[^']*'|\"[^\"]*\")|(?<![\w.-])\d[\d,.]*(?![\w-])")


def _findings(
    old: Evidence, new: Evidence, unasked: Iterable[tuple[str, str]]
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Return the opened, the closed and the reworded findings.

    A finding on a claim is identified by the claim. Any other finding is identified by its text without the
    numbers. If a finding concerns an ``unasked`` claim or a stratum that no longer exists, the finding is not
    reported as closed.
    """
    gone = {stratum.name for stratum in old.strata} - {stratum.name for stratum in new.strata}
    left = (*(f"claim {claim} " for claim, _ in unasked), *(f"{name}: " for name in gone))
    earlier, later = _open_in(old), _open_in(new)
    opened: list[str] = []
    closed: list[str] = []
    reworded: list[tuple[str, str]] = []
    for key, was, now in both(earlier, later):
        if now is None and key.startswith(left):
            continue
        if was is None or now is None:
            (opened if was is None else closed).append((now or was or (0, ""))[1])
        elif was[0] < now[0]:
            opened.append(now[1])
        elif was[1] != now[1]:
            reworded.append((was[1], now[1]))
    return tuple(opened), tuple(closed), tuple(reworded)


def _open_in(evidence: Evidence) -> dict[str, tuple[int, str]]:
    """Return a mapping from a key of each finding to its severity and its text.

    The key of a finding does not depend on the numbers in its text.
    """
    claims = {f"claim-{item.number}": item for item in evidence.claims}
    # The longest name first, because one name may begin another.
    strata = sorted((item.name for item in evidence.strata), key=len, reverse=True)
    findings: dict[str, tuple[int, str]] = {}
    times: Counter[str] = Counter()
    for item in evidence.findings:
        claim = claims.get(item.place)
        severity = SEVERITY.index(claim.standing) if claim else 0
        name = next((f"{name}: " for name in strata if item.text.startswith(f"{name}: ")), "")
        rest = item.text.removeprefix(name)
        key = f"claim {claim.sentence}" if claim else name + _QUOTED_OR_NUMBER.sub(r"\1", rest)
        # Several findings may have the same key; their numbers tell them apart.
        times[key] += 1
        findings[f"{key} {times[key]}"] = severity, item.text
    return findings


def _carried(old: Evidence, new: Evidence, was: Identity, now: Identity) -> Iterator[CarriedPart]:
    """Yield each part of the earlier evidence, and whether it also applies to the later system.

    The parts are the runs of each stratum, the proofs and the self-test.
    """
    earlier = {item.name: item for item in old.strata}
    everywhere = [
        f"the {name.replace('_', ' ')} changed"
        for name in ("seed", "world", "stop_early")
        if getattr(old.plan, name) != getattr(new.plan, name)
    ]
    judged = {claim.sentence for claim in old.claims}
    everywhere += [f"never judged: {item.sentence}" for item in new.claims if item.sentence not in judged]
    for stratum in new.strata:
        part = f"{stratum.planned} runs of {stratum.name}"
        if stratum.name not in earlier:
            yield CarriedPart(part, False, "the stratum is new")
            continue
        foreign = {item.space for item in (*old.strata, *new.strata)} - {stratum.space}
        foreign |= {old.plan.file, new.plan.file}
        why = _of_stratum(was, stratum.name, foreign).changes(_of_stratum(now, stratum.name, foreign))
        why += everywhere
        if (there := earlier[stratum.name].made) < stratum.planned:
            why.append(f"{there} runs are there")
        same = "its space, the system, the software and the judged claims are the same"
        yield CarriedPart(part, not why, "; ".join(why) or same)
    if old.proven is not None:
        known = any(value == old.proven.network_sha256 for _, value in now.parts)
        reason = "it is the same network, by its hash" if known else "the network changed"
        yield CarriedPart("what was proven of the network", known, reason)
    if old.selftest is not None:
        known = old.selftest.present and old.provenance.source_hash == new.provenance.source_hash
        yield CarriedPart("the self-test", known, f"the source is {'the same' if known else 'another'}")


def _of_stratum(identity: Identity, stratum: str, foreign: set[str]) -> Identity:
    """Return the entries of ``identity`` on which the runs of ``stratum`` depend.

    The result excludes the ``foreign`` files, which are the plan's own file and the spaces of other strata.
    """
    mine = f"{SYSTEM} in {stratum}"
    return Identity(
        tuple(
            (name, value)
            for name, value in identity.parts
            if name.removeprefix("the file ") not in foreign
            and (name == mine or not name.startswith(f"{SYSTEM} in "))
        )
    )
