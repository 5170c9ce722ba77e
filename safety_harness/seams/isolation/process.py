"""The process of a user's file as the harness handles it: start, messages within a time limit, end."""

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
    """One process; ``hear`` receives the bytes of its output.

    ``command`` starts it, with two more arguments: the descriptors at which it reads our messages and writes
    its answers. Its output is then standard output and standard error. If ``by_stdio``, a program receives
    and sends messages on standard input and output, so that its output is standard error alone. The process
    may hold MEMORY_BYTES of data.
    """

    def __init__(
        self, command: Sequence[str], hear: Callable[[bytes], None], *, by_stdio: bool = False
    ) -> None:
        """Start the process; OSError if it cannot start."""
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
        output = self._child.stderr if by_stdio else self._child.stdout
        assert output is not None
        self.channel = Channel(question, answer, output.fileno(), hear, self._ended)
        self._finish = weakref.finalize(self, _finish, self.owner, self._child, (question, answer))
        with contextlib.suppress(OSError):  # it has ended already
            if by_stdio:
                limit(self._child.pid)

    @classmethod
    def python(cls, module: str, hear: Callable[[bytes], None]) -> Process:
        """Start a Python that runs ``main`` of our ``module`` with the two descriptors, and limits itself."""
        return cls([sys.executable, "-P", "-u", "-c", BOOT, module, json.dumps(sys.path)], hear)

    def end(self) -> None:
        """Kill the process and its forks, after passing on the rest of its output."""
        if self._finish.alive and self.channel.drain():
            self._hear(b"")
        self._finish()

    def _ended(self) -> GoneError:
        """Return the error that states how the process ended.

        The method leaves the process unreaped, so that its group keeps its number until the group is killed.
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
    """Kill the process and its group once; a fork of ours that inherited it only closes its descriptors."""
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
