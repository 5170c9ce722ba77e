"""Replace the system under test by the reference system of a comparison.

Refuse a comparison of a system with itself.
"""

from __future__ import annotations

import filecmp
import os
from dataclasses import replace

from safety_harness.admission.avoiders import NAMES, avoider_file_of, is_a_program, with_avoider
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.scenario.model import Driver, Scenario
from safety_harness.scenario.references import file_and_name, names_a_program

UNFILTERED = "the unfiltered system"  # the reference of a comparison: the system without its safety filter


def reference_for(tested: str | None, reference: str | None) -> str | None:
    """Return the reference given by ``--against``, which is compared with the system under test.

    The result is a ``Driver`` if ``reference`` names a controller of this package or refers to a program. The
    result is also a ``Driver`` if the tested system is a driver and no avoider has the name ``reference``.
    UNFILTERED is returned unchanged. Raise InadmissibleError if ``reference`` is the tested system itself.
    """
    if reference is None:
        return None
    from safety_harness.cell.controller.named import NAMES as CONTROLLERS  # slow, and few commands need it

    driver = reference in CONTROLLERS or names_a_program(reference)
    driver |= isinstance(tested, Driver) and reference not in (*NAMES, UNFILTERED)
    refuse_itself(tested, reference)
    return Driver(reference) if driver else reference


def refuse_itself(tested: str | None, reference: str | None, option: str = "--against") -> None:
    """Raise InadmissibleError if two references are equal, or denote the same name in the same file.

    Args:
        tested: The reference to the system under test.  None means that the scenario's own system is tested.
        reference: The reference to the system with which it is compared.
        option: The command-line option for ``reference``, for the error message.

    """
    whole = {
        (os.path.realpath(os.path.expanduser(file)), name) if file else (str(system), "")
        for system in (tested, reference)
        for file, name in [file_and_name(system or "")]
    }
    if tested is not None and len(whole) == 1:
        got = f"{reference} itself; a comparison with itself has no findings"
        raise InadmissibleError.of_option(option, f"another reference than {tested}", got)


def refuse_same(tested: Scenario | None, reference: Scenario, option: str = "--against") -> None:
    """Raise InadmissibleError if both scenarios test the same system.

    The function recognises an alias and a copied file.

    Args:
        tested: The scenario under test.  None means that there is no comparison.
        reference: The same scenario with the reference system in place of the system under test.
        option: The command-line option for the reference system, for the error message.

    """
    if tested is None or tested.safety_filter != reference.safety_filter:
        return
    if tested == reference or _is_copy(tested, reference):
        refuse_itself(reference.under_test, reference.under_test, option)


def _is_copy(tested: Scenario, reference: Scenario) -> bool:
    """Return whether the files of both scenarios' systems have the same bytes.

    A program in another folder is not regarded as a copy, because it may read other files there.
    """
    sides = tested, reference
    first, second = (avoider_file_of(replace(side, avoider=str(side.under_test))) for side in sides)
    own, name = (file_and_name(side.under_test)[1] for side in sides)
    if first is None or second is None or own != name or not (first.is_file() and second.is_file()):
        return False
    beside = first.parent == second.parent or not is_a_program(tested.under_test)
    return beside and filecmp.cmp(first, second, shallow=False)


def with_reference(scenario: Scenario, reference: str, place: Place) -> Scenario:
    """Return the scenario with the reference of a comparison in place of its avoider or controller.

    If the reference is UNFILTERED, the function only removes the safety filter.  Raise InadmissibleError at
    ``place`` if the reference cannot be used, or if there is no filter to remove.
    """
    if reference != UNFILTERED:
        return with_avoider(scenario, reference, place)
    if not scenario.safety_filter:
        raise InadmissibleError(place=place, expected="a scenario with a safety filter", got="one without")
    return replace(scenario, safety_filter="")
