"""An avoider from a user's own Python file: what its text defines, and what its execution gives."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import NoReturn

from safety_harness.base.exceptions import AvoiderError, InadmissibleError, Place
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to, spread_threshold_of
from safety_harness.seams.isolation.python_file import made_by, raised, refuse_lacking
from safety_harness.seams.isolation.python_file import refuse_undefined as refuse_undefined_there

AVOIDER = Place(field="avoider")  # who asked for it knows the place of the reference to it
QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m", "seed")  # the keywords of propose
METHODS = ("propose",)
HINT = "safety-harness docs avoiders#a-python-file"


def refuse_undefined(path: Path, name: str, place: Place) -> None:
    """InadmissibleError at ``place`` unless the file is Python and seems to define an avoider ``name``."""
    refuse_undefined_there(path, name, METHODS, place, HINT, QUESTION)


def avoider_in(path: Path, source: bytes, name: str) -> Avoider:
    """The avoider called ``name``: an object, or an instance of a class without required arguments.

    InadmissibleError, at a place that its receiver knows better, if the file ``path`` gives none.
    """
    return _admissible(path, made_by(path, source, name, "an avoider", AVOIDER, HINT), name)


def _admissible(path: Path, found: object, name: str) -> Avoider:
    """``found`` if it has what an avoider needs."""
    try:
        refuse_lacking(found, name, METHODS, AVOIDER, HINT)
        propose = found.propose  # type: ignore[attr-defined]  # as has just been looked at
    except InadmissibleError:
        raise
    except Exception as error:  # a user's property
        raise raised(path, AVOIDER, f"{name} to have a name and a propose", error) from error
    question = QUESTION + (("seen",) if getattr(found, "sees", None) else ())
    asked = f"propose(*, {', '.join(question)})"
    try:
        signature = inspect.signature(propose)
        signature.bind(**dict.fromkeys(question))
    except TypeError:
        _refuse(AVOIDER, f"{name} to have {asked}", f"propose{signature}")
    except ValueError:
        pass  # a function that is not written in Python does not tell
    avoider: Avoider = found  # type: ignore[assignment]  # as has just been looked at
    for read, attribute, kind in (
        (spread_threshold_of, "spread_threshold_m", "a length"),
        (decision_time_of, "decision_time_s", "a time"),
        (shown_to, "sees", "of words that avoiders are shown"),
    ):
        try:
            read(avoider)
        except AvoiderError as error:
            _refuse(AVOIDER, f"{name} to have a {attribute} that is {kind}, or none", str(error))
        except Exception as error:  # a user's property
            raise raised(path, AVOIDER, f"{name} to have a {attribute} that can be read", error) from error
    return avoider


def _refuse(place: Place, expected: str, got: str) -> NoReturn:
    raise InadmissibleError(place=place, expected=expected, got=got, hint=HINT) from None
