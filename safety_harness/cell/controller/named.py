"""Find the controller of a reference: a shipped controller, or a user's own file or program."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from safety_harness.base.exceptions import InadmissibleError, Place, described, near_miss
from safety_harness.base.extension_points import ExtensionPoint, part_named
from safety_harness.base.extras import ONNX
from safety_harness.base.shipped.contents import located
from safety_harness.cell.controller.python_file import HINT, METHODS, checked_controller
from safety_harness.cell.controller.stop_when_near import StopWhenNear
from safety_harness.scenario.files import resolved
from safety_harness.scenario.model import VISUAL_SERVO
from safety_harness.scenario.references import (
    EXEC,
    LEARNED,
    MODEL_SUFFIX,
    added_way,
    file_and_name,
    names_a_program,
    names_onnx,
)
from safety_harness.seams.contract import ControllerOpener, UserController
from safety_harness.seams.isolation.python_file import refuse_undefined

Make = Callable[[], UserController]

LEARNED_FILE = Path(__file__).resolve().parents[2] / "models" / "learned-policy.onnx"


def learned_policy() -> UserController:
    """Return the policy of examples/train_a_policy.py.

    Raise ``MissingPackageError`` if onnxruntime is not installed.
    """
    ONNX.require(LEARNED)
    from safety_harness.cell.controller.out_of_process.onnx_policy import (
        OnnxPolicy,  # its imports serve this controller only
    )

    return OnnxPolicy(LEARNED_FILE, LEARNED_FILE.read_bytes())


SHIPPED: dict[str, Make] = {StopWhenNear.name: StopWhenNear, LEARNED: learned_policy}
NAMES = (VISUAL_SERVO, *SHIPPED)
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME; FILE.onnx; exec:COMMAND; tcp:HOST:PORT; unix:PATH"
CONTROLLER = Place(field="controller")


def controller_of(reference: str, folder: Path | None, place: Place = CONTROLLER) -> Make:
    """Return the function that makes a controller.

    A user's controller runs in its own process.

    Args:
        reference: The controller's name, file, program or address, as in a scenario.
        folder: The folder from which a relative file path starts. None means the working directory. A program
            and the files among its arguments are relative to the working directory.
        place: The place that an error states.

    Raises:
        InadmissibleError: There is no such controller.

    """
    if reference in SHIPPED:
        return SHIPPED[reference]
    if scheme := added_way(reference):
        opener = part_named(ExtensionPoint.CONTROLLERS, scheme, ControllerOpener)
        return partial(_opened, opener, reference, place)
    from safety_harness.cell.controller.out_of_process.references import of_file, of_program

    if names_a_program(reference):
        return of_program(reference, place)
    path, name = controller_file(reference, folder, place)
    return of_file(path, name, place, onnx=names_onnx(reference))


def _opened(opener: ControllerOpener, reference: str, place: Place) -> UserController:
    """Return the controller that a package's ``opener`` opens.

    Raise ``InadmissibleError`` at ``place`` if the opener raises an exception.
    """
    try:
        controller = opener.open(reference)
    except Exception as error:  # another package's module may raise anything
        expected = "a controller that can be opened"
        got = f"{reference}: {described(error)}"
        raise InadmissibleError(place=place, expected=expected, got=got) from error
    return checked_controller(controller, reference, place)


def refuse_unusable_controller(reference: str, folder: Path | None, place: Place) -> None:
    """Raise each error of ``controller_of`` that the harness can find without executing a user's code.

    Args:
        reference: The controller, in the form that ``controller_of`` accepts.
        folder: The folder from which a relative file path starts.
        place: The place that an error states.

    """
    if reference in SHIPPED:
        return
    if scheme := added_way(reference):
        part_named(ExtensionPoint.CONTROLLERS, scheme, ControllerOpener)
        return
    if names_a_program(reference):
        from safety_harness.cell.controller.out_of_process.references import of_program

        of_program(reference, place)
        return
    path, name = controller_file(reference, folder, place)
    if not names_onnx(reference):
        refuse_undefined(path, name, METHODS, place, HINT)


def controller_file(reference: str, folder: Path | None, place: Place = CONTROLLER) -> tuple[Path, str]:
    """Return the existing file of a user's controller, and the controller's name in the file.

    Args:
        reference: The controller, in the form that ``controller_of`` accepts.
        folder: The folder from which a relative file path starts.
        place: The place that an error states.

    Raises:
        InadmissibleError: The reference is not valid, or the file does not exist.

    """
    file, name = file_and_name(reference)
    if not file or file.endswith(MODEL_SUFFIX):
        hint = near_miss(reference, NAMES, most=3)
        if reference.endswith(".py"):
            hint = f"name the class in it as well: {reference}:NAME"
        if os.path.exists(reference.partition(" ")[0]):
            hint = f"for a program write {EXEC}{reference}"
        raise InadmissibleError(place=place, expected=FORMS, got=repr(reference), hint=hint)
    path = resolved(located((folder or Path()) / os.path.expanduser(file)))
    if not path.is_file():
        raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")
    return path, name


def controller_sha256(reference: str, folder: Path | None) -> str:
    """Return the hash of a controller's file.

    The hash is empty for the harness's own code and for a program at a socket.
    """
    if reference == LEARNED:
        return hashlib.sha256(LEARNED_FILE.read_bytes()).hexdigest()
    if reference in NAMES:
        return ""
    if scheme := added_way(reference):
        hashes = part_named(ExtensionPoint.CONTROLLERS, scheme, ControllerOpener).sha256
        return "" if hashes is None else hashes(reference)
    if names_a_program(reference):
        from safety_harness.cell.controller.out_of_process.references import program_sha256

        return program_sha256(reference, CONTROLLER)
    return hashlib.sha256(controller_file(reference, folder)[0].read_bytes()).hexdigest()
