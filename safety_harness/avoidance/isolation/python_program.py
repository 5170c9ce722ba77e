"""Avoiders of a user's Python file, in its own process: naming one executes the file there."""

from __future__ import annotations

from pathlib import Path

from safety_harness.avoidance.isolation.host import LONGEST_S, RefusedError, Wanted, host_of
from safety_harness.avoidance.isolation.isolated import IsolatedAvoider
from safety_harness.avoidance.isolation.process import GoneError
from safety_harness.avoidance.python_text import source_of
from safety_harness.exceptions import InadmissibleError, Place


def isolated_avoider(path: Path, name: str, place: Place) -> IsolatedAvoider:
    """The avoider called ``name`` in a Python file, which is executed in another process.

    InadmissibleError at ``place`` if there is none, or the process does not live to say so.
    """
    source = source_of(path, place)
    try:
        return IsolatedAvoider.of(host_of(path, source), Wanted({"attribute": name}, LONGEST_S))
    except RefusedError as error:
        raise InadmissibleError(
            place=place, expected=error.expected, got=error.got, hint=error.hint
        ) from error
    except GoneError as error:
        within = f" within {LONGEST_S:g} s" if error.hung else ""
        raise InadmissibleError(
            place=place, expected=f"{path.name} to give an avoider {name}{within}", got=str(error)
        ) from error
