"""Wrappers of ours hand on what an avoider asks to see."""

from __future__ import annotations

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.extensions.selftest.avoider_faults import FaultyAvoider
from safety_harness.extensions.selftest.avoider_faults import sound_answer as soundly
from safety_harness.search.confirm import OtherDraws
from tests.cell.avoidance.test_avoiders_that_see import TWO_HANDS, Watching


def test_wrappers_of_ours_hand_on_what_is_seen() -> None:
    for wrap in (lambda one: OtherDraws(one, 1), lambda one: FaultyAvoider(one, soundly)):
        avoider = Watching()
        run_kinematic(admit(TWO_HANDS, avoider=wrap(avoider)))  # type: ignore[no-untyped-call]
        assert avoider.shown
