"""Two processes do not compile the same function at once, and an error leaves no lock."""

from __future__ import annotations

import fcntl
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import pytest
from numba.core.errors import TypingError

from safety_harness.base import compile_lock, compiled
from safety_harness.base.compile_lock import hold, release

HOLDER = """
import sys
from pathlib import Path
from safety_harness.base.compile_lock import hold
hold(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_process_waits_until_the_holder_of_the_lock_ends(tmp_path: Path) -> None:
    file = tmp_path / "one.lock"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        waiting = threading.Thread(target=hold, args=(file,))
        waiting.start()
        waiting.join(0.3)
        assert waiting.is_alive()
        holder.kill()  # even a process that is killed gives its lock back
    waiting.join(30.0)
    assert not waiting.is_alive()
    release(file)
    assert not file.exists()


def test_a_wait_for_a_suspended_process_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_lock, "LONGEST_WAIT_S", 0.3)
    file = tmp_path / "one.lock"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        assert not hold(file)
        assert not hold(file, wait=False)
        holder.kill()


def test_two_processes_never_hold_a_lock_whose_file_was_removed_meanwhile(tmp_path: Path) -> None:
    file = tmp_path / "one.lock"
    counts = tmp_path / "count"
    counts.write_text("0")
    program = """
import sys
from pathlib import Path
from safety_harness.base.compile_lock import hold, release
file, counts = map(Path, sys.argv[1:])
for _ in range(200):
    assert hold(file)
    counts.write_text(str(int(counts.read_text()) + 1))
    release(file)
"""
    command = [sys.executable, "-c", program, str(file), str(counts)]
    both = [subprocess.Popen(command) for _ in range(3)]
    assert [one.wait(60.0) for one in both] == [0, 0, 0]
    assert counts.read_text() == "600"


def test_a_forked_process_does_not_keep_a_lock_that_was_given_back(tmp_path: Path) -> None:
    file = tmp_path / "one.lock"
    hold(file)
    child = os.fork()
    if not child:
        time.sleep(5.0)
        os._exit(0)
    waiting = os.open(file, os.O_RDWR)
    release(file)
    fcntl.flock(waiting, fcntl.LOCK_EX | fcntl.LOCK_NB)  # would raise
    os.close(waiting)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def test_a_function_may_come_by_pickle_from_another_process() -> None:
    program = "import pickle, sys; print(pickle.loads(sys.stdin.buffer.read())(3.0))"
    sent = pickle.dumps(compiled.compiled(lambda x: x + x))
    done = subprocess.run([sys.executable, "-c", program], input=sent, capture_output=True, check=True)
    assert done.stdout == b"6.0\n"


def test_a_process_may_take_its_own_lock_again(tmp_path: Path) -> None:
    hold(tmp_path / "one.lock")
    hold(tmp_path / "one.lock")
    release(tmp_path / "one.lock")
    release(tmp_path / "one.lock")
    assert not any(tmp_path.iterdir())


def test_where_nothing_can_be_written_there_is_no_lock(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    hold(tmp_path / "file" / "one.lock")
    assert not compile_lock._held


def test_a_function_that_cannot_be_compiled_leaves_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    monkeypatch.setattr(compiled, "cache_folder", compiled.cache_folder.__wrapped__)
    wrong = compiled.compiled(lambda x: x.no_such_attribute)
    with pytest.raises(TypingError):
        wrong(1.0)
    assert not compile_lock._held
    assert not list(tmp_path.rglob("*.lock"))
    half = compiled.compiled(lambda x: x / 2.0)
    assert half(1.0) == 0.5
    assert not compile_lock._held
    assert not list(tmp_path.rglob("*.lock"))


def test_code_of_another_signature_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def half(x: float) -> float:
        return x / 2

    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    monkeypatch.setattr(compiled, "cache_folder", compiled.cache_folder.__wrapped__)
    first = compiled.compiled(half)
    assert (first(3), first(3.0)) == (1.5, 1.5)
    integers, floats = sorted(tmp_path.rglob("*.nbc"))
    floats.write_bytes(integers.read_bytes())  # as two processes without a lock may leave them
    again = compiled.compiled(half)
    assert (again(3), again(5.0)) == (1.5, 2.5)


def test_a_function_that_another_process_compiled_while_this_one_waited_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(x: float) -> float:
        return x / 2.0

    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    monkeypatch.setattr(compiled, "cache_folder", compiled.cache_folder.__wrapped__)
    other = compiled.compiled(half)
    finished = iter((lambda: other(3.0),))  # at the first wait, the other process finishes
    monkeypatch.setattr(compiled, "hold", lambda file: next(finished, lambda: hold(file))())
    mine = compiled.compiled(half)
    assert mine(3.0) == 1.5
    assert mine.stats.cache_hits == {(numba.float64,): 1}
    assert not compile_lock._held
