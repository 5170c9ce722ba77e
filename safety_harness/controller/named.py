"""Which controller a reference means: one that ships, by its name, or a user's own."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

from safety_harness.controller.contract import UserController
from safety_harness.controller.stop_when_near import StopWhenNear
from safety_harness.exceptions import InadmissibleError, Place, near_miss
from safety_harness.scenario.files import resolved
from safety_harness.scenario.model import VISUAL_SERVO
from safety_harness.scenario.references import file_and_name
from safety_harness.shipped.contents import located

Make = Callable[[], UserController]

SHIPPED: dict[str, Make] = {StopWhenNear.name: StopWhenNear}
NAMES = (VISUAL_SERVO, *SHIPPED)
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME"
CONTROLLER = Place(field="controller")


def controller_of(reference: str, folder: Path | None, place: Place = CONTROLLER) -> Make:
    """What makes a fresh controller, one that ships or of a user's file, which is executed.

    A relative file is sought in ``folder``.  InadmissibleError at ``place`` if there is none.
    """
    if reference in SHIPPED:
        return SHIPPED[reference]
    path = controller_file(reference, folder, place)
    name = file_and_name(reference)[1]
    # Until controllers have a process of their own: here, in this one.
    from safety_harness.controller.python_file import controller_in

    source = path.read_bytes()
    controller_in(path, source, name, place)
    return lambda: controller_in(path, source, name, place)


def controller_file(reference: str, folder: Path | None, place: Place = CONTROLLER) -> Path:
    """The file of a user's controller, which is there; InadmissibleError at ``place``."""
    file, name = file_and_name(reference)
    if not (file and name):
        hint = near_miss(reference, NAMES, most=3)
        if reference.endswith(".py"):
            hint = f"name the class in it as well: {reference}:NAME"
        raise InadmissibleError(place=place, expected=FORMS, got=repr(reference), hint=hint)
    path = resolved(located((folder or Path()) / os.path.expanduser(file)))
    if not path.is_file():
        raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")
    return path


def controller_sha256(reference: str, folder: Path | None) -> str:
    """The hash of the file that a controller comes from; empty for one that ships."""
    if reference in NAMES:
        return ""
    return hashlib.sha256(controller_file(reference, folder).read_bytes()).hexdigest()
