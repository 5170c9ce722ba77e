"""``safety-harness`` of a process that is ready: it has imported and loaded all, and forks for each command.

A command of its own spends most of its time on that, and a tutorial has many.  What ``command`` writes is a
program of that name: it hands its folder, words and streams over, and ends as the fork does.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NAMES = ("stdin", "stdout", "stderr")
_CLIENT = """\
#!{python} -SE
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as asking:
    asking.connect({address!r})
    socket.send_fds(asking, [json.dumps([os.getcwd(), sys.argv[1:]]).encode()], [0, 1, 2])
    sys.exit(int(asking.recv(16)))
"""


@contextmanager
def command(environment: dict[str, str]) -> Iterator[Path]:
    """A folder with the program ``safety-harness``, until it is no more needed."""
    with tempfile.TemporaryDirectory() as folder:  # of a short name: a socket's may have a hundred letters
        address = f"{folder}/socket"
        words = [sys.executable, __file__, address]
        with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as serving:
            assert serving.stdout is not None
            assert serving.stdout.readline() == "ready\n"
            program = Path(folder, "safety-harness")
            program.write_text(_CLIENT.format(python=sys.executable, address=address))
            program.chmod(0o755)
            try:
                yield Path(folder)
            finally:
                serving.terminate()


def _serve(address: str) -> None:
    """Fork for each command that is asked for; the fork returns, with its folder, words and streams."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        gc.collect()
        gc.freeze()  # no fork looks through what is loaded
        print("ready", flush=True)
        while True:
            asking, _ = listening.accept()
            with asking:
                told, streams, *_ = socket.recv_fds(asking, 1 << 16, 3)
                child = os.fork()
                if child == 0:
                    atexit._clear()  # of files that all forks use
                    folder, words = json.loads(told)
                    os.chdir(folder)
                    sys.argv = ["safety-harness", *words]
                    for number, (stream, name) in enumerate(zip(streams, NAMES, strict=True)):
                        os.dup2(stream, number)
                        os.close(stream)
                        setattr(sys, name, open(number, "w" if number else "r"))  # noqa: SIM115
                    return
                for stream in streams:
                    os.close(stream)
                ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
                asking.sendall(str(ended).encode())


def _load() -> None:
    """Run what needs most of it, which leaves no thread behind that a fork would lack."""
    from typer.testing import CliRunner

    from safety_harness.cli.main import app
    from safety_harness.extensions.assurance.certification import certify, verify  # noqa: F401

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for words in (
            "copy shipped:first-run",
            "run first-run.yaml",
            "replay reports/run/traces/first-run.trace",
        ):
            done = CliRunner().invoke(app, words.split())
            assert done.exit_code == 0, done.output
        os.chdir("/")


if __name__ == "__main__":
    _load()
    _serve(sys.argv[1])
    from safety_harness.__main__ import main

    sys.exit(main())
