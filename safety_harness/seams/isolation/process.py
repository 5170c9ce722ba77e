"""The process of a user's file: its start, its channel for messages, and its end."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Sequence

from safety_harness.seams.isolation.channel import Channel, GoneError
from safety_harness.seams.isolation.child import limit
from safety_harness.seams.isolation.opened import environment

BOOT = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[2]); from importlib import import_module; "
    "import_module(sys.argv[1]).main(int(sys.argv[3]), int(sys.argv[4]))"
)


class Process:
    """A process that the harness started.

    ``hear`` receives the bytes of its output. Two arguments are added to ``command``: the descriptors from
    which the process reads our messages and to which it writes its answers. In this case, its output is
    everything on standard output and standard error. If ``by_stdio`` is true, a program instead receives
    messages on standard input and sends answers on standard output, so that only standard error is its
    output. The data of the process may occupy at most MEMORY_BYTES.
    """

    def __init__(
        self, command: Sequence[str], hear: Callable[[bytes], None], *, by_stdio: bool = False
    ) -> None:
        """Start the process.

        Raise OSError if the process cannot start.
        """
        self._hear = hear
        self.owner = os.getpid()
        variables, journal = environment()
        question_in, question = os.pipe()
        answer, answer_out = os.pipe()
        try:
            self._child = subprocess.Popen(
                [*command] if by_stdio else [*command, str(question_in), str(answer_out)],
                stdin=question_in if by_stdio else subprocess.DEVNULL,
                stdout=answer_out if by_stdio else subprocess.PIPE,
                stderr=subprocess.PIPE if by_stdio else subprocess.STDOUT,
                pass_fds=() if by_stdio else (question_in, answer_out, journal),
                env=None if by_stdio else variables,
                start_new_session=True,  # Ctrl-C reaches only us, and its forks are in its group
            )
        except OSError:
            os.close(question)
            os.close(answer)
            raise
        finally:
            os.close(question_in)
            os.close(answer_out)
        # If both streams carry output, they share one pipe, so that the order of lines is kept.
        output = self._child.stderr if by_stdio else self._child.stdout
        assert output is not None
        self.channel = Channel(question, answer, output.fileno(), hear, self._ended)
        self._finish = weakref.finalize(self, _finish, self.owner, self._child, (question, answer))
        with contextlib.suppress(OSError):  # it has ended already
            if by_stdio:
                limit(self._child.pid)

    @classmethod
    def python(cls, module: str, hear: Callable[[bytes], None]) -> Process:
        """Start Python to run ``main`` of our ``module``, with the two descriptors as its arguments.

        The process then limits its own memory.
        """
        return cls([sys.executable, "-P", "-u", "-c", BOOT, module, json.dumps(sys.path)], hear)

    def end(self) -> None:
        """Pass on the rest of the output, and then kill the process and its forks."""
        if self._finish.alive and self.channel.drain():
            self._hear(b"")
        self._finish()

    def _ended(self) -> GoneError:
        """Return an error about the way in which the process ended.

        The method does not remove the ended process from the process table. Its number therefore stays
        reserved until the group is killed.
        """
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            state = os.waitid(os.P_PID, self._child.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG)
            if state is None:
                time.sleep(0.001)
            elif state.si_code == os.CLD_EXITED:
                return GoneError(f"its process ended with exit status {state.si_status}")
            else:
                return GoneError(f"its process was ended by {signal.Signals(state.si_status).name}")
        return GoneError("its process closed the line to us")


def _finish(owner: int, child: subprocess.Popen[bytes], fds: tuple[int, ...]) -> None:
    """Kill the process and its group.

    In a fork of the harness that inherited the object, only close its descriptors.
    """
    if os.getpid() == owner:
        for kill in (os.killpg, os.kill):  # it may have left its group
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(child.pid, signal.SIGKILL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(timeout=5.0)
    else:
        child.returncode = 0  # this process need not wait for it
    for fd in fds:
        os.close(fd)
    for output in (child.stdout, child.stderr):
        if output is not None:
            output.close()
