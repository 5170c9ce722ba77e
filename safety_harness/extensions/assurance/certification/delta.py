"""What changed from one evidence report to a later one, what got worse, and which runs carry over.

Worse is: a claim that was shown in a stratum and is not any more (because it is gone, too), a target or a
confidence that was lowered, what was not shown and is not asked any more, a finding that was opened, a proof
that is gone, a hazard that was as rare as is asked and is not any more, and a violation probability that is
*shown* to be larger.  That is so where the exact interval of the difference, paired by episode, lies above
zero; or, where the two reports drew other episodes, where the two intervals have no value in common.
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
    """A claim that stands otherwise, or for another target; None where it is not in the plan.

    ``stratum`` is empty for the claim as a whole.
    """

    sentence: str
    stratum: str
    before: ClaimStatus | None
    after: ClaimStatus | None
    target_before: float | None
    target_after: float | None


@dataclass(frozen=True)
class BoundChange:
    """A bound that is another.  ``worse`` and ``better`` are shown, by ``how``; both may be untrue."""

    sentence: str
    stratum: str
    before: Bound | None
    after: Bound | None
    worse: bool
    better: bool
    how: str


@dataclass(frozen=True)
class CarriedPart:
    """A part of the earlier evidence: whether it also speaks of the later system, and ``why`` (not)."""

    what: str
    carries: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class EvidenceDelta:
    """The whole comparison.  ``before`` and ``after`` are the folders' names with the roots of their rows.

    ``bases`` say what the verdicts of each rest on.
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
    reworded: tuple[tuple[str, str], ...]  # findings that are open still, with other numbers
    carried: tuple[CarriedPart, ...]

    @property
    def empty(self) -> bool:
        """Is nothing another?"""
        return not (self.parts or self.claims or self.bounds or self.opened or self.closed or self.reworded)

    @property
    def line(self) -> str:
        """In one sentence."""
        if self.empty:
            return "nothing changed"
        if self.regressions:
            return f"{len(self.regressions)} got worse since {self.before[0]}"
        return f"nothing got worse since {self.before[0]}"

    def as_text(self) -> str:
        """As JSON."""
        return json.dumps(plain(self), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


@dataclass(frozen=True, eq=False)
class EarlierReport:
    """A finished report whose files are those that its manifest has."""

    folder: Path
    evidence: Evidence

    @classmethod
    def read(cls, folder: Path) -> EarlierReport:
        """InputError for what is no report, one that is not finished, or one whose files were altered."""
        hashes = read_manifest(folder)
        if faults := check_files(folder, hashes).faults:
            expected = "the folder of a report as certify wrote it"
            hint = f"safety-harness verify {folder} looks at all of it"
            raise InputError(place=Place(file=folder), expected=expected, got="; ".join(faults), hint=hint)
        evidence = read_evidence(folder / JSON)
        if evidence.interrupted:
            raise InputError(
                place=Place(file=folder), expected="a finished report", got="one with runs missing"
            )
        return cls(folder, evidence)


def delta_of(earlier: EarlierReport, later: EarlierReport) -> EvidenceDelta:
    """From the earlier to the later one; InputError for a ledger that cannot be read."""
    with ExitStack() as stack:
        reports = (earlier, later)
        first, second = (stack.enter_context(Ledger.open(one.folder / LEDGER, alone=True)) for one in reports)
        _refuse_order(earlier, first, second)
        return delta_between(
            earlier.evidence,
            later.evidence,
            names=(earlier.folder.resolve().name, later.folder.resolve().name),
            identities=(first.declared.identity, second.declared.identity),
            paired=_paired(first, second),
        )


def _refuse_order(earlier: EarlierReport, first: Ledger, second: Ledger) -> None:
    """InputError for the runs of one report twice, and for a later report in the place of the earlier."""
    refuse_itself(first, second)
    was, now = (began_at(one)[-1:] for one in (first, second))
    if was > now:
        expected, got = "the earlier report first", f"runs that began at {was[0]}, before which others began"
        raise InputError(place=Place(file=earlier.folder), expected=expected, got=f"{got} at {''.join(now)}")


Paired = dict[tuple[str, str], tuple[float, float, float]]


def delta_between(
    before: Evidence,
    after: Evidence,
    *,
    names: tuple[str, str],
    identities: tuple[Identity, Identity],
    paired: Paired,
) -> EvidenceDelta:
    """By (claim, stratum) ``paired`` has the difference's interval (later minus earlier) and its confidence.

    ``identities`` are what the runs of each hang on.
    """
    if len(set(map(edition_of, identities))) > 1:
        before, after = (
            _named(one, edition_of(of)) for one, of in zip((before, after), identities, strict=True)
        )
    bounds = tuple(_bounds(before, after, paired))
    unasked = dict(_unasked(before, after))
    opened, closed, reworded = _findings(before, after, unasked)
    return EvidenceDelta(
        format=FORMAT,
        before=(names[0], before.record.rows_sha256),
        after=(names[1], after.record.rows_sha256),
        bases=(f"{names[0]}: {before.basis}", f"{names[1]}: {after.basis}"),
        regressions=(
            *_lost(before, after),
            *unasked.values(),
            *_loosened(before, after),
            *(_worse_words(one) for one in bounds if one.worse),
            *_unproven(before, after),
            *_unrated(before, after),
            *(f"a finding was opened: {text}" for text in opened),
        ),
        parts=tuple(parts_changed(before, after)),
        claims=tuple(_claims(before, after)),
        bounds=bounds,
        opened=opened,
        closed=closed,
        reworded=reworded,
        carried=tuple(_carried(before, after, *identities)),
    )


def _named(evidence: Evidence, edition: int) -> Evidence:
    """Return a report with its claims in the words of today: edition 1 takes hands to come at WALKING_MPS."""
    if edition > 1:
        return evidence
    kept = ProtectiveSeparation().sentence
    now = ProtectiveSeparation(hand_speed_mps=WALKING_MPS).sentence
    claims = (replace(one, sentence=now) if one.sentence == kept else one for one in evidence.claims)
    return replace(evidence, claims=tuple(claims))


def _claims_by(evidence: Evidence) -> dict[str, ClaimEvidence]:
    return {claim.sentence: claim for claim in evidence.claims}


def _claims(before: Evidence, after: Evidence) -> Iterator[ClaimChange]:
    targets = [{one.sentence: one.target for one in each.claims} for each in (before, after)]
    earlier, later = (_standings(each) for each in (before, after))
    for sentence, stratum in dict.fromkeys([*earlier, *later]):
        key = (sentence, stratum)
        was, now = (earlier.get(key), targets[0].get(sentence)), (later.get(key), targets[1].get(sentence))
        if was[0] is not now[0] or (was != now and not stratum):
            yield ClaimChange(sentence, stratum, was[0], now[0], was[1], now[1])


def _standings(evidence: Evidence) -> dict[tuple[str, str], ClaimStatus]:
    """Of each claim as a whole, and in each stratum."""
    whole = {(claim.sentence, ""): claim.standing for claim in evidence.claims}
    return whole | {key: one.standing for key, one in _outcomes(evidence).items()}


def _outcomes(evidence: Evidence) -> dict[tuple[str, str], ClaimResult]:
    return {(claim.sentence, one.stratum): one for claim in evidence.claims for one in claim.outcomes}


def _lost(before: Evidence, after: Evidence) -> Iterator[str]:
    """What was shown and is not now: in a stratum, or over all of the plan's."""
    outcomes, claims = _outcomes(after), _claims_by(after)
    told = set()
    for (sentence, stratum), was in _outcomes(before).items():
        now = outcomes.get((sentence, stratum))
        if was.standing is ClaimStatus.SHOWN and (now is None or now.standing is not ClaimStatus.SHOWN):
            told.add(sentence)
            gone = f"the {'stratum' if sentence in claims else 'claim'} is not in the plan any more"
            words = gone if now is None else f"{now.standing.value}: {now.why}"
            yield f"{sentence}, {stratum}: shown before, now {words}"
    for sentence, claim, later in both(_claims_by(before), claims):
        lost = claim and claim.standing is ClaimStatus.SHOWN is not (later and later.standing)
        if lost and later and sentence not in told:
            yield f"{sentence}: shown before, now {later.standing.value}: {later.why}"


def _unasked(before: Evidence, after: Evidence) -> Iterator[tuple[tuple[str, str], str]]:
    """By (claim, stratum) what was asked and not shown, and is gone or asked of another space now."""
    later, claims = _outcomes(after), _claims_by(after)
    spaces = [{one.name: one.space_sha256 for one in each.strata} for each in (before, after)]
    for key, was in _outcomes(before).items():
        now = later.get(key)
        if was.standing in (ClaimStatus.SHOWN, ClaimStatus.ESTIMATED):
            continue
        why = f"the {'stratum' if key[0] in claims else 'claim'} is not in the plan"
        if now is not None:
            if now.standing is not ClaimStatus.SHOWN or spaces[0].get(key[1]) == spaces[1].get(key[1]):
                continue
            why = "its space is another"
        yield key, f"{', '.join(key)}: {was.standing.value} before, not asked any more: {why}"


def _loosened(before: Evidence, after: Evidence) -> Iterator[str]:
    """A lower confidence, and a target that is larger than one that was met and is not met any more."""
    if after.plan.confidence < before.plan.confidence:
        lower, higher = percent(after.plan.confidence), percent(before.plan.confidence)
        yield f"the bounds hold with {lower} confidence, {higher} before"
    claims = _claims_by(before)
    for claim in after.claims:
        target = claims[claim.sentence].target if claim.sentence in claims else None
        for one in claim.outcomes:
            was = _outcomes(before).get((claim.sentence, one.stratum))
            kept = one.bound is not None and target is not None and one.bound.upper <= target
            if was and was.standing is one.standing is ClaimStatus.SHOWN and target and not kept:
                yield f"{claim.sentence}, {one.stratum}: shown for a larger target, not for {percent(target)}"


def _paired(first: Ledger, second: Ledger) -> Paired:
    """Each difference's interval, later minus earlier, and its confidence; none for other episodes."""
    try:
        compared = compare_ledgers(first, second)
    except (LedgerError, StatisticsError):
        return {}
    return {(one.claim, one.stratum): (one.low, one.high, one.confidence) for one in compared}


def _bounds(before: Evidence, after: Evidence, paired: Paired) -> Iterator[BoundChange]:
    earlier, later = _outcomes(before), _outcomes(after)
    for key in dict.fromkeys([*earlier, *later]):
        was, now = (found[key].bound if key in found else None for found in (earlier, later))
        if was == now:
            continue
        worse = better = False
        how = "there is nothing to hold it against"
        if was and now and key in paired:
            low, high, confidence = paired[key]
            worse, better = low > 0.0, high < 0.0
            how = (
                f"the difference, paired by episode, is {100 * low:+.3g} % to {100 * high:+.3g} %, "
                f"{100 * confidence:.4g} % alone"
            )
        elif was and now:
            worse, better = now.lower > was.upper, now.upper < was.lower
            how = "other episodes: the two intervals are held against each other"
        yield BoundChange(*key, was, now, worse, better, how)


def _worse_words(one: BoundChange) -> str:
    return (
        f"{one.sentence}, {one.stratum}: {interval(one.before)} before, {interval(one.after)} now; {one.how}"
    )


def interval(bound: Bound | None) -> str:
    """Both ends in words."""
    return NONE if bound is None else f"{at_least(bound.lower)} to {at_most(bound.upper)}"


def _unproven(before: Evidence, after: Evidence) -> Iterator[str]:
    for name, was, now in both(proofs_in(before), proofs_in(after)):
        if was == "proven" != now:
            yield f"{name}: proven before, now {now or 'no proof is given'}"


def _unrated(before: Evidence, after: Evidence) -> Iterator[str]:
    """A hazard whose rates were shown to be as low as asked."""
    if before.plan.model_only:
        return
    earlier, later = ({one.name: one for one in each.hazards} for each in (before, after))
    for name, was, now in both(earlier, later):
        if was and was.met and not (now and now.met and not after.plan.model_only):
            words = "not shown to be now" if now else "the hazard is not in the plan any more"
            yield f"{name}: as rare as is asked before, {words}"


_QUOTED_OR_NUMBER = re.compile(r"('[^']*'|\"[^\"]*\")|(?<![\w.-])\d[\d,.]*(?![\w-])")


def _findings(
    before: Evidence, after: Evidence, unasked: Iterable[tuple[str, str]]
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Opened, closed, and told otherwise: a claim's finding is its own, another is known by its words.

    One of an ``unasked`` claim, or of a stratum that is gone, is not closed.
    """
    gone = {one.name for one in before.strata} - {one.name for one in after.strata}
    left = (*(f"claim {claim} " for claim, _ in unasked), *(f"{name}: " for name in gone))
    earlier, later = _open_in(before), _open_in(after)
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
    """Each finding by what stays of it when its numbers change: how grave it is, and its text."""
    claims = {f"claim-{one.number}": one for one in evidence.claims}
    strata = sorted((one.name for one in evidence.strata), key=len, reverse=True)
    found: dict[str, tuple[int, str]] = {}
    times: Counter[str] = Counter()
    for one in evidence.findings:
        claim = claims.get(one.place)
        gravity = SEVERITY.index(claim.standing) if claim else 0
        name = next((f"{name}: " for name in strata if one.text.startswith(f"{name}: ")), "")
        rest = one.text.removeprefix(name)
        key = f"claim {claim.sentence}" if claim else name + _QUOTED_OR_NUMBER.sub(r"\1", rest)
        times[key] += 1
        found[f"{key} {times[key]}"] = gravity, one.text
    return found


def _carried(before: Evidence, after: Evidence, was: Identity, now: Identity) -> Iterator[CarriedPart]:
    """Stratum by stratum, then the proofs and the self-test."""
    earlier = {one.name: one for one in before.strata}
    everywhere = [
        f"the {name.replace('_', ' ')} is another"
        for name in ("seed", "world", "stop_early")
        if getattr(before.plan, name) != getattr(after.plan, name)
    ]
    judged = {claim.sentence for claim in before.claims}
    everywhere += [f"never judged: {one.sentence}" for one in after.claims if one.sentence not in judged]
    for stratum in after.strata:
        what = f"{stratum.planned} runs of {stratum.name}"
        if stratum.name not in earlier:
            yield CarriedPart(what, False, "the stratum is new")
            continue
        others = {one.space for one in (*before.strata, *after.strata)} - {stratum.space}
        others |= {before.plan.file, after.plan.file}
        why = _of_stratum(was, stratum.name, others).changes(_of_stratum(now, stratum.name, others))
        why += everywhere
        if (there := earlier[stratum.name].made) < stratum.planned:
            why.append(f"{there} runs are there")
        same = "its space, the system, the software and the claims that were judged are the same"
        yield CarriedPart(what, not why, "; ".join(why) or same)
    if before.proven is not None:
        known = any(value == before.proven.network_sha256 for _, value in now.parts)
        words = "it is the same network, by its hash" if known else "the network is another"
        yield CarriedPart("what was proven of the network", known, words)
    if before.selftest is not None:
        known = before.selftest.present and before.provenance.source_hash == after.provenance.source_hash
        yield CarriedPart("the self-test", known, f"the source is {'the same' if known else 'another'}")


def _of_stratum(identity: Identity, stratum: str, others: set[str]) -> Identity:
    """What of an identity the runs of a stratum hang on: not the plan, nor other strata's own files."""
    mine = f"{SYSTEM} in {stratum}"
    return Identity(
        tuple(
            (name, value)
            for name, value in identity.parts
            if name.removeprefix("the file ") not in others
            and (name == mine or not name.startswith(f"{SYSTEM} in "))
        )
    )
