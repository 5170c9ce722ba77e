"""Ctrl-C is for the first process to answer."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from safety_harness.base.interrupts import deaf_children
from safety_harness.base.pool import pool

DEAF = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))"


def is_deaf() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def asked() -> str:
    return subprocess.run(
        [sys.executable, "-c", DEAF], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_a_process_started_meanwhile_hears_none_and_a_later_one_does() -> None:
    with deaf_children():
        assert asked() == "True"
    assert asked() == "False"


def test_one_that_comes_meanwhile_is_heard_afterwards() -> None:
    went_on = []

    def meanwhile() -> None:
        with deaf_children():
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
            time.sleep(0.01)
            went_on.append(True)

    with pytest.raises(KeyboardInterrupt):
        meanwhile()
    assert went_on


def test_the_processes_of_a_pool_hear_none_from_the_beginning() -> None:
    with pool(1) as executor:
        assert executor.submit(is_deaf).result()
