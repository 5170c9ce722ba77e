"""Load a user's controller from a Python file, which this process executes."""

from __future__ import annotations

from pathlib import Path

from safety_harness.base.exceptions import ControllerError, InadmissibleError, Place
from safety_harness.seams.contract import UserController, reports_of, sees_of
from safety_harness.seams.isolation.python_file import made_by, refuse_lacking

METHODS = ("reset", "act")
HINT = "safety-harness docs how-to/controller"


def controller_in(path: Path, source: bytes, name: str, place: Place) -> UserController:
    """Return the controller ``name`` of a file.

    If ``name`` is a class, the function creates an instance without arguments.
    """
    return checked_controller(made_by(path, source, name, "a controller", place, HINT), name, place)


def checked_controller(candidate: object, name: str, place: Place) -> UserController:
    """Return ``candidate`` if it follows the contract.

    Raise ``InadmissibleError`` at ``place`` if it does not.
    """
    refuse_lacking(candidate, name, METHODS, place, HINT)
    controller: UserController = candidate  # type: ignore[assignment]  # checked by ``refuse_lacking``
    try:
        sees_of(controller)
        reports_of(controller)
    except ControllerError as error:
        expected = f"{name} to follow the contract"
        raise InadmissibleError(place=place, expected=expected, got=str(error)) from None
    return controller
