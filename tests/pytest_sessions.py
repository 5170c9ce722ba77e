"""Pytest as a user starts it, in forks of one process that has loaded what the plug-in needs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import safety_harness
from safety_harness.base.compiled import cache_root

CACHE = cache_root().parent  # asked for now: pytester moves the home folder
ROOT = Path(safety_harness.__file__).parents[1]
TEMPLATE = Path(__file__).parent / "testing" / "plugin" / "template.py"

HEAD = """\
{title}
duration: 1.2 s
avoider: opposite pose
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [1000 mm, -500 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - reach for tcp: {speed}
        stop at distance: 20 mm
        give up after: 2 s
claims:
"""
CLAIMS = "  hand distance never below 50 mm: {distance}\n  TCP speed never above 250 mm/s: holds\n"


class Sessions:
    """What starts one after another; see ``template.py``."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process = process
        self.outputs = tuple(folder / name for name in ("out", "err"))

    def __call__(
        self, folder: Path, *args: str, environment: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        """``python -m pytest`` in a folder."""
        asked = {"args": args, "folder": str(folder), "environment": {**(environment or os.environ)}}
        files = dict(zip(("out", "err"), map(str, self.outputs), strict=True))
        print(json.dumps(asked | files), file=self.process.stdin, flush=True)
        assert self.process.stdout is not None
        code = int(self.process.stdout.readline())
        return subprocess.CompletedProcess(args, code, *(path.read_text() for path in self.outputs))


@contextmanager
def sessions_in(folder: Path) -> Iterator[Sessions]:
    """They stand for all sessions that need no fresh process; their output is kept in ``folder``."""
    scenario = folder / "fast.yaml"
    scenario.write_text(
        HEAD.format(title="scenario: a fast reach", speed="2 m/s") + CLAIMS.format(distance="holds")
    )
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "SAFETY_HARNESS_CACHE": str(CACHE),
    }
    command, pipe = [sys.executable, str(TEMPLATE), str(scenario)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment, cwd=ROOT) as process:
        yield Sessions(process, folder)
        assert process.stdin is not None
        process.stdin.close()
