"""A process that has loaded what the plug-in's sessions need, and forks for each: seconds less a session.

A line of standard input is a session: arguments, folder, environment and the files of its output; its exit
code is the line that comes back.  The plug-in is imported here and registered by the session.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import random
import sys
from pathlib import Path

import hypothesis  # noqa: F401 (for its import, as those below)
import pytest
import xdist.looponfail
import xdist.newhooks
import xdist.plugin  # noqa: F401
from _pytest.config import builtin_plugins

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.cell.simulation import pybullet_world  # noqa: F401
from safety_harness.report import decisions  # noqa: F401
from safety_harness.scenario import expand  # noqa: F401
from safety_harness.scenario.read import parse_scenario
from safety_harness.space import strategy  # noqa: F401
from safety_harness.testing.plugin import collecting, ending, payloads, plugin, running  # noqa: F401

# That the package is there before pytest, which would rewrite its assertions if it had any.
LOADED = ("-W", "ignore:Module already imported so cannot be rewritten:pytest.PytestAssertRewriteWarning")


def session(args: list[str], folder: str, environment: dict[str, str], out: str, err: str) -> int:
    """``python -m pytest`` with these arguments, in the process that calls it."""
    random.seed()  # as a process that starts
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for stream, path in ((1, out), (2, err)):
        with open(path, "wb") as file:
            os.dup2(file.fileno(), stream)
    sys.path[0] = folder
    sys.argv = ["pytest", *LOADED, *args]
    return pytest.console_main()


def main() -> None:
    for name in builtin_plugins:  # of pytest, which a session loads one by one
        importlib.import_module(f"_pytest.{name}")
    run = run_kinematic(admit(parse_scenario(Path(sys.argv[1]).read_text(), file=Path(sys.argv[1]))))
    judge(run)  # loads machine code
    gc.collect()
    gc.freeze()  # or each session looks at all that is loaded, again and again, and copies the pages of it
    while line := sys.stdin.readline():
        child = os.fork()
        if child == 0:
            code = session(**json.loads(line))
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)  # without taking apart what is loaded, which takes as long as a short session
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
