"""What a reference to a controller elsewhere means, and how it is begun.

FILE.py:NAME      a Python file, executed in a process of its own
FILE.onnx         a policy, in a process of its own
exec:COMMAND      a program, with its arguments, as typed in a shell in the working directory
tcp:HOST:PORT     a program that listens on this machine
unix:PATH         a program that listens at a Unix socket
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.base.extras import ONNX
from safety_harness.base.whole_file import sha256_of as whole_hash
from safety_harness.cell.controller.out_of_process.lines import (
    FileLine,
    Line,
    ProgramLine,
    RefusedControllerError,
    SocketLine,
)
from safety_harness.cell.controller.out_of_process.remote import RemoteController
from safety_harness.cell.controller.python_file import checked_controller
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.references import EXEC, TCP, UNIX
from safety_harness.seams.contract import UserController
from safety_harness.seams.isolation.channel import GoneError
from safety_harness.seams.isolation.opened import DECLARED
from safety_harness.seams.isolation.python_file import source_of

LOOPBACK = ("localhost", "127.0.0.1")
MOST_ONNX_BYTES = 256 * 2**20
_DECLARING = re.compile(rb"^[ \t#/;%%-]*%s *[=:] *(\[[^\]]*\]|.*)$" % DECLARED.encode(), re.MULTILINE)
_BRACKETS = str.maketrans("[](),;", "      ")


def made_from(begun: Callable[[], Line], what: str, place: Place) -> UserController:
    """The controller at the end of a line; InadmissibleError at ``place`` if there is none."""
    line = begun()
    try:
        controller = RemoteController(line)
    except RefusedControllerError as said:
        raise InadmissibleError(place=place, expected=said.expected, got=said.got, hint=said.hint) from said
    except GoneError as gone:
        within = f" within {line.begin_s:g} s" if gone.hung else ""
        expected = f"{what} to be a controller{within}"
        raise InadmissibleError(place=place, expected=expected, got=str(gone)) from gone
    try:
        return checked_controller(controller, what, place)
    except InadmissibleError:
        line.end()
        raise


def of_python(path: Path, name: str, place: Place) -> Callable[[], UserController]:
    """What makes controllers of a Python file, each in a process of its own."""
    source = source_of(path, place)
    return lambda: made_from(lambda: FileLine(path, source, name), f"{name} of {path.name}", place)


def of_onnx(path: Path, layout: str, place: Place) -> Callable[[], UserController]:
    """What makes controllers of an ONNX file of this layout; MissingPackageError without onnxruntime."""
    ONNX.require(f"the controller {path.name}")
    source = read_bytes(path, most=MOST_ONNX_BYTES, place=place, error=InadmissibleError)
    if len(source) > MOST_ONNX_BYTES:
        expected = f"an ONNX file of at most {MOST_ONNX_BYTES:,} bytes"
        raise InadmissibleError(place=place, expected=expected, got="a larger one")
    return lambda: made_from(lambda: FileLine(path, source, layout), path.name, place)


def of_program(reference: str, place: Place) -> Callable[[], UserController]:
    """What makes controllers of ``exec:``, ``tcp:`` and ``unix:``, each with a process or connection."""
    if reference.startswith(EXEC):
        command, executable = _command(reference, place)
        return lambda: made_from(
            lambda: ProgramLine(command, executable, _contents(command, executable)), executable.name, place
        )
    address = _address(reference, place)
    return lambda: made_from(lambda: SocketLine(address), f"who listens at {reference}", place)


def refuse_no_program(reference: str, place: Place) -> None:
    """InadmissibleError at ``place`` for a program that is not there, or no address; nothing is executed."""
    if reference.startswith(EXEC):
        _command(reference, place)
    else:
        _address(reference, place)


def program_sha256(reference: str, place: Place) -> str:
    """The hash of a program, of the files among its arguments, and of those that they declare.

    Empty for a program at a socket; InadmissibleError at ``place`` for a declared file that cannot be read.
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
    """The bytes of the executable and of the arguments that are files, one after another.

    Of a single file they are its own, so that its hash is the file's.  The hash of each file that they
    declare follows: ``HARNESS_FILES = ["weights.bin"]`` or ``HARNESS_FILES="weights.bin"`` at the beginning
    of a line, or of a comment.
    """
    files = [executable, *(Path(word) for word in command[1:] if os.path.isfile(word))]
    parts = [file.read_bytes() for file in files]
    for file, text in zip(files, tuple(parts), strict=True):
        for names in _DECLARING.findall(text):
            words = shlex.split(os.fsdecode(names).translate(_BRACKETS), comments=True)
            parts += [
                bytes.fromhex(whole_hash(file.parent / name)) for word in words for name in word.split()
            ]
    return b"".join(parts)


def _command(reference: str, place: Place) -> tuple[list[str], Path]:
    """The words of a command, and the file that it executes."""
    try:
        command = shlex.split(reference.removeprefix(EXEC))
    except ValueError as error:
        expected = f"{EXEC} and a command as a shell takes it"
        raise InadmissibleError(place=place, expected=expected, got=f"{reference!r}: {error}") from None
    if not command:
        raise InadmissibleError(place=place, expected=f"{EXEC} and a command", got=repr(reference))
    command[0] = os.path.expanduser(command[0])
    found = shutil.which(command[0])
    if found is None:
        there = os.path.exists(command[0])
        got = f"{command[0]}, which may not be executed" if there else f"no such program: {command[0]}"
        hint = f"chmod +x {command[0]}" if there else "a program in this folder is named ./NAME"
        expected = "a program that can be executed"
        raise InadmissibleError(place=place, expected=expected, got=got, hint=hint)
    return command, Path(found).absolute()


def _address(reference: str, place: Place) -> tuple[str, int] | str:
    """A port of this machine, or the path of a socket."""
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
            hint="a program of another machine is reached through a tunnel, as of ssh -L",
        )
    return host, int(port)
