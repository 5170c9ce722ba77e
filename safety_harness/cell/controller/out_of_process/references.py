"""Start the controller of a reference in another process.

FILE.py:NAME      a Python file, executed in a process of its own FILE.onnx         a policy, in a process of
its own exec:COMMAND      a program, with its arguments, as typed in a shell in the working directory
tcp:HOST:PORT     a program that listens on this machine unix:PATH         a program that listens at a Unix
socket
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shlex
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.base.extras import ONNX
from safety_harness.base.whole_file import sha256_of as whole_hash
from safety_harness.cell.avoidance.model_file import onnx_bytes
from safety_harness.cell.controller.out_of_process.messages import (
    MOST_BYTES,
    Hello,
    said_by_process,
    said_by_program,
)
from safety_harness.cell.controller.out_of_process.remote import RemoteController
from safety_harness.cell.controller.python_file import checked_controller
from safety_harness.scenario.references import EXEC, TCP, UNIX
from safety_harness.seams.contract import UserController
from safety_harness.seams.isolation.connection import (
    Connection,
    Peer,
    Socket,
    Wire,
    binary_wire,
    json_wire,
    process_of,
    refusing,
)
from safety_harness.seams.isolation.messages import Make, ProcessMessage
from safety_harness.seams.isolation.opened import DECLARED
from safety_harness.seams.isolation.process import Process
from safety_harness.seams.isolation.python_file import source_of

LOOPBACK = ("localhost", "127.0.0.1")
LOGGER = logging.getLogger("safety_harness.controller")
PYTHON_S = 300.0  # for the import
BEGIN_S = 60.0  # the limit for the start or connection together with the first message
CHILD = "safety_harness.cell.controller.out_of_process.child"
_DECLARING = re.compile(rb"^[ \t#/;%%-]*%s *[=:] *(\[[^\]]*\]|.*)$" % DECLARED.encode(), re.MULTILINE)
Making = Callable[[], UserController]
_BRACKETS = str.maketrans("[](),;", "      ")


def of_file(path: Path, name: str, place: Place, *, onnx: bool) -> Making:
    """Return the function that makes the controllers of a file, each in its own process.

    ``name`` is the attribute of a Python file, or the layout of a policy. ``onnx`` states that the file is an
    ONNX policy. Raise ``MissingPackageError`` for an ONNX policy if onnxruntime is not installed.
    """
    if onnx:
        ONNX.require(f"the controller {path.name}")
        subject, source = path.name, onnx_bytes(path, place, InadmissibleError)
    else:
        subject, source = f"{name} of {path.name}", source_of(path, place)
    first = partial(Make.from_file, path, source, name, onnx=onnx)
    made = partial(_made, binary_wire(said_by_process.decode, MOST_BYTES), first, PYTHON_S, place)
    return lambda: made(subject, process_of(path, source, LOGGER, partial(Process.python, CHILD)))


def of_program(reference: str, place: Place) -> Making:
    """Return the function that makes controllers from an ``exec:``, ``tcp:`` or ``unix:`` reference.

    Each controller has its own process or connection. Raise ``InadmissibleError`` at ``place`` if there is no
    such program or address. This function itself does not execute the program.
    """
    subject, start = peer_of(reference, place, BEGIN_S, LOGGER)
    return partial(
        _made, json_wire(said_by_program.decode, MOST_BYTES), Hello, BEGIN_S, place, subject, start
    )


def peer_of(
    reference: str, place: Place, within_s: float, logger: logging.Logger
) -> tuple[str, Callable[[], Peer]]:
    """Return a description of a program for messages, and the function that starts it or connects to it.

    Args:
        reference: A reference that begins with ``exec:``, ``tcp:`` or ``unix:``.
        place: The place that an error states.
        within_s: The time limit [s] for a connection.
        logger: The logger for the program's output.

    Raises:
        InadmissibleError: There is no such program or address.

    """
    if not reference.startswith(EXEC):
        return f"who listens at {reference}", partial(Socket, _address(reference, place), within_s)
    command, executable = _command(reference, place)
    begin = partial(Process, command, by_stdio=True)
    return executable.name, process_of(executable, _contents(command, executable), logger, begin)


def _made(
    wire: Wire,
    first: Callable[[], ProcessMessage],
    within_s: float,
    place: Place,
    subject: str,
    start: Callable[[], Peer],
) -> UserController:
    """Return the controller after its first message.

    Raise ``InadmissibleError`` at ``place`` if no valid message arrives.
    """
    connection = Connection(start, wire)
    try:
        with refusing(InadmissibleError, f"{subject} to be a controller", within_s, place):
            controller = RemoteController(connection, first, within_s)
        return checked_controller(controller, subject, place)
    except BaseException:
        connection.end()
        raise


def program_sha256(reference: str, place: Place) -> str:
    """Return one hash for a program, the files among its arguments, and the files that these declare.

    The hash is empty for a program at a socket. Raise ``InadmissibleError`` at ``place`` if a declared file
    is unreadable.
    """
    if not reference.startswith(EXEC):
        return ""
    command, executable = _command(reference, place)
    try:
        return hashlib.sha256(_contents(command, executable)).hexdigest()
    except (OSError, ValueError) as error:
        expected = f"{DECLARED} to be a list of files that can be read"
        raise InadmissibleError(place=place, expected=expected, got=str(error)) from error


def _contents(command: list[str], executable: Path) -> bytes:
    """Return the bytes of the executable, of the arguments that are files, and of the declared files.

    For a single file, the result is the contents of the file, so that its hash is the file's hash. For a
    declared file, the result contains its hash instead of its bytes. A file declares further files by the
    text ``HARNESS_FILES = ["weights.bin"]`` or ``HARNESS_FILES="weights.bin"``. The text must be at the
    beginning of a line or of a comment.
    """
    files = [executable, *(Path(item) for item in command[1:] if os.path.isfile(item))]
    parts = [file.read_bytes() for file in files]
    for file, text in zip(files, tuple(parts), strict=True):
        for names in _DECLARING.findall(text):
            declared = shlex.split(os.fsdecode(names).translate(_BRACKETS), comments=True)
            parts += [
                bytes.fromhex(whole_hash(file.parent / name)) for item in declared for name in item.split()
            ]
    return b"".join(parts)


def _command(reference: str, place: Place) -> tuple[list[str], Path]:
    """Return the words of the command in ``reference``, and the path of the executable."""
    try:
        command = shlex.split(reference.removeprefix(EXEC))
    except ValueError as error:
        expected = f"{EXEC} and a command as a shell takes it"
        raise InadmissibleError(place=place, expected=expected, got=f"{reference!r}: {error}") from None
    if not command:
        raise InadmissibleError(place=place, expected=f"{EXEC} and a command", got=repr(reference))
    command[0] = os.path.expanduser(command[0])
    executable = shutil.which(command[0])
    if executable is None:
        there = os.path.exists(command[0])
        got = f"{command[0]}, which may not be executed" if there else f"no such program: {command[0]}"
        hint = f"chmod +x {command[0]}" if there else "write ./NAME for a program in this folder"
        expected = "a program that can be executed"
        raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
    return command, Path(executable).absolute()


def _address(reference: str, place: Place) -> tuple[str, int] | str:
    """Return the host and the port on this machine, or the path of a Unix socket."""
    if reference.startswith(UNIX):
        path = os.path.expanduser(reference.removeprefix(UNIX))
        if not os.path.exists(path):
            got = f"no such socket: {path}" if path else repr(reference)
            raise InadmissibleError(place=place, expected=f"{UNIX} and the path of a socket", got=got)
        return path
    host, _, port = reference.removeprefix(TCP).rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65_536 or host not in LOOPBACK:
        raise InadmissibleError(
            place=place,
            expected=f"{TCP}HOST:PORT, HOST one of: {', '.join(LOOPBACK)}",
            got=repr(reference),
            hint="for a program on another machine use a tunnel, such as ssh -L",
        )
    return host, int(port)
