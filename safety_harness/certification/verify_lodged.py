"""Is a report what was declared before its runs, and sealed after them?  Only hashes from elsewhere tell."""

from __future__ import annotations

import re
from pathlib import Path

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.certification.check import Examination, few
from safety_harness.certification.declaration import PlanDeclaration, declaration_of, read_declaration
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.seal import Seal, read_seal, seal_of
from safety_harness.exceptions import InputError, Place

NO_SEAL = (
    "no lodged seal was given (--seal): a careful forger who makes all hashes anew may have altered rows, of "
    "which only stored traces and runs made again tell, and what nothing but the report says: its times, "
    "machine and command, what the search did, tables that were handed in"
)
NOT_DECLARED = (
    "no lodged declaration was given (--declared): nothing proves that plan, seed and targets came first"
)
_HASH = re.compile(r"[0-9a-f]{64}")


def lodged_hash(text: str | None, field: str) -> str | Path | None:
    """A hash as it was lodged, or the file that it is of; InputError for neither."""
    if text is None or _HASH.fullmatch(text.strip().lower()):
        return text and text.strip().lower()
    if Path(text).is_file():
        return Path(text)
    raise InputError(
        place=Place(field=field), expected="a hash of 64 hexadecimal digits, or its file", got=repr(text)[:80]
    )


def check_lodged(
    folder: Path,
    plan: Plan,
    ledger: Ledger,
    recorded: Evidence,
    *,
    seal: str | Path | None,
    declared: str | Path | None,
) -> Examination:
    """Against what was lodged elsewhere, or what it means that nothing was."""
    faults, notes, unchecked = [], [], []
    if seal is None:
        unchecked.append(NO_SEAL)
    else:
        faults += _differs(seal, seal_of(folder, ledger), "seal")
        notes.append("nothing in the report was altered since it was sealed")
    if declared is None:
        unchecked.append(NOT_DECLARED)
    else:
        faults += _differs(declared, declaration_of(plan, ledger.declared.identity), "declaration")
        notes.append(
            "plan, seed, avoider, targets and software are the declared ones; its runs began on "
            f"{recorded.provenance.began_at}: the declaration has to have been lodged before"
        )
    root = recorded.record.rows_sha256
    text = f"the root over all rows, {root[:16]}, and what was lodged elsewhere"
    return Examination("lodged", text, few(faults), () if faults else tuple(notes), tuple(unchecked))


def _differs(lodged: str | Path, now: Seal | PlanDeclaration, what: str) -> list[str]:
    """In words, if it does; what of it is otherwise is known from the file only."""
    if isinstance(lodged, str):
        return (
            []
            if lodged == now.sha256
            else [f"the {what} of this report is {now.sha256}, not what was lodged"]
        )
    changes = (
        read_seal(lodged).changes(now) if isinstance(now, Seal) else read_declaration(lodged).changes(now)
    )
    return list(changes)
