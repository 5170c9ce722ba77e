"""Check and load an avoider from a user's own Python file."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import NoReturn

from safety_harness.base.exceptions import AvoiderError, InadmissibleError, Place
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to, spread_threshold_of
from safety_harness.seams.isolation.python_file import made_by, raised, refuse_lacking
from safety_harness.seams.isolation.python_file import refuse_undefined as refuse_undefined_there

AVOIDER = Place(field="avoider")  # the caller replaces it by the place of the reference
QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m", "seed")  # the keywords of propose
METHODS = ("propose",)
HINT = "safety-harness docs how-to/avoider#a-python-file"


def refuse_undefined(path: Path, name: str, place: Place) -> None:
    """Raise ``InadmissibleError`` unless a Python file may define an avoider called ``name``.

    The error states ``place``. The function reads the file's text and does not execute it.
    """
    refuse_undefined_there(path, name, METHODS, place, HINT, QUESTION)


def avoider_in(path: Path, source: bytes, name: str) -> Avoider:
    """Return the avoider ``name`` of a file.

    If ``name`` is a class, the function creates an instance without arguments. Raise ``InadmissibleError`` if
    the file ``path`` has no such avoider. The caller replaces the place in this error.
    """
    return _admissible(path, made_by(path, source, name, "an avoider", AVOIDER, HINT), name)


def _admissible(path: Path, candidate: object, name: str) -> Avoider:
    """Return ``candidate`` if it has the members of an avoider; raise ``InadmissibleError`` otherwise."""
    try:
        refuse_lacking(candidate, name, METHODS, AVOIDER, HINT)
        propose = candidate.propose  # type: ignore[attr-defined]  # checked by ``refuse_lacking``
    except InadmissibleError:
        raise
    except Exception as error:  # a user's property
        raise raised(path, AVOIDER, f"{name} to have a name and a propose", error) from error
    question = QUESTION + (("seen",) if getattr(candidate, "sees", None) else ())
    call = f"propose(*, {', '.join(question)})"
    try:
        signature = inspect.signature(propose)
        signature.bind(**dict.fromkeys(question))
    except TypeError:
        _refuse(AVOIDER, f"{name} to have {call}", f"propose{signature}")
    except ValueError:
        pass  # a function that is not written in Python has no signature
    avoider: Avoider = candidate  # type: ignore[assignment]  # checked above
    for read, attribute, kind in (
        (spread_threshold_of, "spread_threshold_m", "a length"),
        (decision_time_of, "decision_time_s", "a time"),
        (shown_to, "sees", "a list of inputs of avoiders"),
    ):
        try:
            read(avoider)
        except AvoiderError as error:
            _refuse(AVOIDER, f"{name} to have a {attribute} that is {kind}, if any", str(error))
        except Exception as error:  # a user's property
            raise raised(path, AVOIDER, f"{name} to have a {attribute} that can be read", error) from error
    return avoider


def _refuse(place: Place, expected: str, got: str) -> NoReturn:
    """Raise an ``InadmissibleError`` with the hint of this module."""
    raise InadmissibleError(place=place, expected=expected, got=got, hint=HINT) from None
