"""``--safety-against``: beside every run of a test that of a reference, which may do no better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from safety_harness.admission.avoiders import told_avoider
from safety_harness.claims.properties.against import ClaimDifference, RunDifference, VerdictChange
from safety_harness.claims.properties.base import Evaluation
from safety_harness.testing.session import session
from safety_harness.testing.simulating import digest_of, simulate
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.trace import Trace

_WORSE = (VerdictChange.NEW, VerdictChange.DEEPER, VerdictChange.SILENT)


def against_reference(
    trace: Trace, mine: Evaluation, judge: Callable[[Trace], Evaluation]
) -> ClaimDifference | None:
    """The same claim in the same scenario with the reference, noted for the summary; None without one."""
    if session().against is None:
        return None
    other = simulate.with_reference(trace)
    found = ClaimDifference(mine=mine, reference=judge(other))
    test = session().test
    if test is not None and test.counts:
        new = RunDifference(
            run=trace.scenario.name,
            claims=(),
            mine=Overruling.of([trace]),
            reference=Overruling.of([other]),
        )
        run = test.differences.setdefault(digest_of(trace.scenario), new)
        claims = (*run.claims, found)
        test.differences[digest_of(trace.scenario)] = replace(run, claims=claims)
    return found


def is_shared(found: ClaimDifference | None) -> bool:
    """Does the reference do no better?  Then the running test does not fail for it, and is skipped."""
    test = session().test
    if found is None or test is None or found.change in _WORSE:
        return False
    test.shared.append(f"{found.mine.sentence}: {_words(found)}")
    return True


def note_of(found: ClaimDifference) -> str:
    """For a failure: what the reference does in the same scenario."""
    return f"{found.change.value}: {found.words(_name())}"


def _words(found: ClaimDifference) -> str:
    mine, other = found.mine, found.reference
    if mine.verdict is other.verdict:
        return (
            f"{other.verdict.value} with {_name()} too ({mine.margin_text()} against {other.margin_text()})"
        )
    return f"{mine.verdict.value}, and {other.verdict.value} with {_name()}"


def _name() -> str:
    return told_avoider(session().against or "")
