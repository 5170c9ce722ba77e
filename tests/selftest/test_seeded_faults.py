"""The catalogue of faults: what it has to hold, and that harmless changes are what they say."""

from __future__ import annotations

from collections import Counter

import pytest
from small import SCENARIOS, shipped, trials

from safety_harness.selftest.catalogue import EVERY, FAULTS, HARMLESS
from safety_harness.selftest.fault import Fault, Part
from safety_harness.selftest.profile import TELLING
from safety_harness.selftest.system import System
from safety_harness.trace.compare import first_difference

NAMES = {fault.name for fault in FAULTS}
WHERE = {  # the scenarios that show a fault of each part, and what is tried there
    "sign flip": "hand-visits-and-leaves",
    "towards the hand in one octant": "between-two-hands",
    "unseeded randomness": "network-certain",
    "memory between episodes": "network-certain",
    "overconfident spread": "network-in-doubt",
    "underconfident spread": "network-certain",
    "threshold ignored": "network-certain",
    "off by some cycles": "second-hand",
    "passes NaN": "network-certain",
    "latency that nobody counts": "hand-visits-and-leaves",
    "swapped image axes": "hand-visits-and-leaves",
    "ghost hands": "hand-visits-and-leaves",
    "lost object not noticed": "fault-camera-blind",
    "overspeed": "network-certain",
    "stop that does not stop": "nothing-reachable",
    "late commands": "hand-visits-and-leaves",
}
BIT_FOR_BIT = {
    "mutates its inputs",
    "seeds the global generator",
    "matrix that is not used",
    "demand during a protective stop",
    "rubbish behind the last box",
    "rubbish between frames",
    "a box that is no measurement",
}


def fault_named(name: str) -> Fault:
    return next(one for one in EVERY if one.name == name)


def test_there_are_forty_at_least_in_every_part_and_no_name_comes_twice() -> None:
    assert len(FAULTS) >= 40
    assert min(Counter(fault.part for fault in FAULTS)[part] for part in Part) >= 8
    assert len({fault.name for fault in EVERY}) == len(EVERY)


def test_the_telling_scenarios_are_shipped() -> None:
    assert set(TELLING) <= {file.stem for file in SCENARIOS.glob("*.yaml")}


def test_each_says_what_it_is() -> None:
    for fault in EVERY:
        assert fault.hazard, fault.name
        assert fault.ladder.values, fault.name
        words = [fault.ladder.words(value) for value in fault.ladder.values]
        assert len(set(words)) == len(words), fault.name
    assert all(fault.harmless for fault in HARMLESS)
    assert not any(fault.harmless for fault in FAULTS)


@pytest.mark.parametrize("name", WHERE)
def test_at_its_gravest_it_is_caught_where_it_shows(name: str) -> None:
    fault = fault_named(name)
    alarms = trials(WHERE[name]).alarms(fault, fault.ladder.values[0], 0)
    assert alarms, name


@pytest.mark.parametrize("fault", HARMLESS, ids=lambda fault: fault.name)
def test_a_harmless_change_raises_no_alarm(fault: Fault) -> None:
    names = ("hand-visits-and-leaves", "nothing-reachable")
    assert not trials(*names).everywhere(fault).caught


@pytest.mark.parametrize("name", sorted(BIT_FOR_BIT))
def test_what_is_said_not_to_matter_at_all_changes_no_bit(name: str) -> None:
    fault = fault_named(name)
    sound = System.of(shipped("nothing-reachable"))
    assert first_difference(sound.run(), fault.seed_into(sound, 1.0).run()) is None


@pytest.mark.parametrize(
    "fault", [one for one in HARMLESS if one.name not in BIT_FOR_BIT], ids=lambda f: f.name
)
def test_the_other_harmless_changes_do_something(fault: Fault) -> None:
    """Else it would be no wonder that they raise no alarm."""
    scenario = "second-hand" if fault.name == "boxes in another order" else "network-certain"
    sound = System.of(shipped(scenario))
    assert first_difference(sound.run(), fault.seed_into(sound, 1.0).run()) is not None
