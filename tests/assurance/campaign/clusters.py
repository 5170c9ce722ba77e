"""Dask schedulers and workers in processes of their own, which end with the ``with``."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def scheduler(folder: Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler in a process of its own, and its address."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1"]
    command += ["--port", str(port), "--no-dashboard", "--scheduler-file", str(file)]
    with started(command) as process:
        wait_until(lambda: file.exists() and file.stat().st_size > 0)
        yield process, str(file)


@contextmanager
def workers(file: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Two, which have imported what they need before they are there."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", file]
    command += ["--no-dashboard", "--nthreads", "1", "--nworkers", "2", "--local-directory", str(folder)]
    with started([*command, "--preload", "safety_harness.extensions.assurance.campaign.cluster"]) as process:
        yield process


@contextmanager
def started(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_until(is_so: object, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not is_so():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.05)
