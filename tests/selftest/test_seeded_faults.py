"""The catalogue of faults: what it has to hold, and that harmless changes are what they say."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from small import SCENARIOS, shipped, trials

from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.extensions.selftest.catalogue import EVERY, FAULTS, HARMLESS
from safety_harness.extensions.selftest.fault import FaultyPart, SeededFault
from safety_harness.extensions.selftest.suite import TELLING
from safety_harness.extensions.selftest.system import Change, ChangedSystem, Records, WorldWrapper
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
    "region not checked": "proven-region",
    "latency that nobody counts": "hand-visits-and-leaves",
    "swapped image axes": "hand-visits-and-leaves",
    "ghost hands": "hand-visits-and-leaves",
    "lost object not noticed": "fault-camera-blind",
    "overspeed": "network-certain",
    "stop that does not stop": "nothing-reachable",
    "shield looks elsewhere": "second-hand",
    "shield forgets links": "second-hand",
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


def fault_named(name: str) -> SeededFault:
    return next(one for one in EVERY if one.name == name)


def test_there_are_forty_at_least_in_every_part_and_no_name_comes_twice() -> None:
    assert len(FAULTS) >= 40
    assert min(Counter(fault.part for fault in FAULTS)[part] for part in FaultyPart) >= 8
    assert len({fault.name for fault in EVERY}) == len(EVERY)


def test_the_telling_scenarios_are_shipped() -> None:
    assert set(TELLING) <= {file.stem for file in SCENARIOS.glob("*.yaml")}


def test_each_says_what_it_is() -> None:
    for fault in EVERY:
        assert fault.hazard, fault.name
        assert fault.ladder.values, fault.name
        words = [fault.ladder.label(value) for value in fault.ladder.values]
        assert len(set(words)) == len(words), fault.name
    assert all(fault.harmless for fault in HARMLESS)
    assert not any(fault.harmless for fault in FAULTS)


@pytest.mark.parametrize("name", WHERE)
def test_at_its_gravest_it_is_caught_where_it_shows(name: str) -> None:
    fault = fault_named(name)
    alarms = trials(WHERE[name]).alarms(fault, fault.ladder.values[0], 0)
    assert alarms, name


@pytest.mark.parametrize("name", sorted(BIT_FOR_BIT))
def test_what_is_said_not_to_matter_at_all_changes_no_bit(name: str) -> None:
    fault = fault_named(name)
    sound = ChangedSystem(shipped(where_it_acts(name)))
    assert first_difference(sound.run(), fault.seed_into(sound, 1.0).run()) is None


def where_it_acts(name: str) -> str:
    """A scenario with protective stops, or with a slow camera for what lies between its frames."""
    return "overhead-camera" if name == "rubbish between frames" else "nothing-reachable"


def said(records: Records) -> bytes:
    """What records say, without the bytes between their fields, which may be anything."""
    return b"".join(records[name].tobytes() for name in records.dtype.names or ())


class Watching(ControllerWrapper):
    """Notes what the controller is shown, and what it says."""

    def __init__(self, pilot: AvoidingServo, seen: list[bytes], told: list[bytes]) -> None:
        super().__init__(pilot)
        self._seen, self._told = seen, told

    def step(self, observation: Records) -> Records:
        self._seen.append(said(observation))
        command = super().step(observation)
        self._told.append(said(command))
        return command


def what_it_changes(fault: SeededFault) -> set[str]:
    """Where something is another thing behind the change than before it, in a run with protective stops."""
    told, obeyed, shown, seen = (list[bytes]() for _ in range(4))
    before, after = list[bytes](), list[bytes]()

    def note(log: list[bytes]) -> Change:
        def look(records: Records) -> Records:
            log.append(said(records))
            return records

        return look

    sound = ChangedSystem(shipped(where_it_acts(fault.name)))
    within = sound.with_world(lambda world: WorldWrapper(world, see=note(shown), obey=note(obeyed)))
    within = within.with_records(lambda records: before.append(said(records.parameters)))
    changed = fault.seed_into(within, 1.0)
    changed = changed.with_records(lambda records: after.append(said(records.parameters)))
    changed.with_pilot(lambda pilot: Watching(pilot, seen, told)).run()
    hand, tcp = np.array([0.9, -0.4, 0.3]), np.array([0.7, -0.2, 0.3])
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(7)  # noqa: NPY002
    drawn = np.random.random()  # noqa: NPY002
    np.random.seed(7)  # noqa: NPY002
    changed.admitted.avoider.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=1)
    differ = {
        "what is seen": shown != seen,
        "what is obeyed": told[: len(obeyed)] != obeyed,  # the last command is not carried out any more
        "what is known": before != after,
        "what was asked": not (hand.any() and tcp.any()),
        "what others draw": np.random.random() != drawn,  # noqa: NPY002
    }
    np.random.set_state(state)  # noqa: NPY002
    return {what for what, differs in differ.items() if differs}


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("mutates its inputs", "what was asked"),
        ("seeds the global generator", "what others draw"),
        ("matrix that is not used", "what is known"),
        ("demand during a protective stop", "what is obeyed"),
        ("rubbish behind the last box", "what is seen"),
        ("rubbish between frames", "what is seen"),
        ("a box that is no measurement", "what is seen"),
    ],
)
def test_and_yet_it_is_made(name: str, where: str) -> None:
    """A change that never acts would change no bit either."""
    assert name in BIT_FOR_BIT
    assert what_it_changes(fault_named(name)) == {where}


def test_the_look_for_changes_sees_none_where_there_is_none() -> None:
    nothing = replace(fault_named("mutates its inputs"), seed_into=lambda system, _: system)
    assert what_it_changes(nothing) == set()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_no_fault_is_caught_for_a_run_that_could_not_be_carried_through(fault: SeededFault) -> None:
    """What a fault raises would be an alarm, and so would a mistake in how it is seeded."""
    system = fault.circumstance.bring_about(ChangedSystem(shipped("network-certain")))
    fault.seed_into(system, fault.ladder.values[0]).run()


@pytest.mark.parametrize(
    "fault", [one for one in HARMLESS if one.name not in BIT_FOR_BIT], ids=lambda f: f.name
)
def test_the_other_harmless_changes_do_something(fault: SeededFault) -> None:
    """Else it would be no wonder that they raise no alarm."""
    scenario = "second-hand" if fault.name == "boxes in another order" else "network-certain"
    sound = ChangedSystem(shipped(scenario))
    assert first_difference(sound.run(), fault.seed_into(sound, 1.0).run()) is not None
