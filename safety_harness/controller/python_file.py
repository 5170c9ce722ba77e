"""A user's controller from a Python file, executed in this process."""

from __future__ import annotations

from pathlib import Path

from safety_harness.avoidance.avoider import described
from safety_harness.avoidance.python_file import module_of
from safety_harness.controller.contract import UserController, reports_of, sees_of
from safety_harness.exceptions import ControllerError, InadmissibleError, Place
from safety_harness.scenario.fields import SENTENCE, is_sentence


def controller_in(path: Path, source: bytes, name: str, place: Place) -> UserController:
    """The controller called ``name``: an object, or an instance of a class without required arguments."""
    found = getattr(module_of(path, source, place), name, None)
    if found is None:
        raise InadmissibleError(
            place=place, expected=f"something called {name!r} in {path.name}", got="nothing of that name"
        )
    if isinstance(found, type):
        try:
            found = found()
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            raise InadmissibleError(
                place=place,
                expected=f"{name}() to make a controller without any arguments",
                got=described(error, str(path)),
            ) from error
    return checked_controller(found, name, place)


def checked_controller(found: object, name: str, place: Place) -> UserController:
    """``found`` if it has what the contract asks for; InadmissibleError at ``place`` says what is missing."""
    for method in ("reset", "act"):
        if not callable(getattr(found, method, None)):
            raise InadmissibleError(
                place=place,
                expected=f"{name} to have a method {method}",
                got=f"none in a {type(found).__name__}",
                hint="safety-harness docs controllers",
            )
    called = getattr(found, "name", None)
    if not isinstance(called, str) or not is_sentence(called):
        expected = f"{name} to have a name, {SENTENCE}"
        raise InadmissibleError(place=place, expected=expected, got=repr(called))
    controller: UserController = found  # type: ignore[assignment]  # as has just been looked at
    try:
        sees_of(controller)
        reports_of(controller)
    except ControllerError as error:
        raise InadmissibleError(
            place=place, expected=f"{name} to follow the contract", got=str(error)
        ) from None
    return controller
