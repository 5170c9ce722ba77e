"""What is said while functions are compiled, and that a cache that cannot be written is."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from safety_harness.base import compiled as module
from safety_harness.base.compiled import compiled
from safety_harness.base.compiling import Compilation, CompilationLine, watchers


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def now(ready: int, seconds: float, *, going_on: bool = True, unwritable: str = "") -> Compilation:
    return Compilation(ready, seconds, going_on, unwritable)


def test_nothing_is_said_of_a_second_and_then_a_line_every_ten() -> None:
    out, time_s = io.StringIO(), [0.0]
    line = CompilationLine(out, clock=lambda: time_s[0])
    for second in range(25):
        time_s[0] = float(second)
        line(now(second, 0.5 + second))
    lines = out.getvalue().splitlines()
    assert [text.rpartition(": ")[2].split(",")[0] for text in lines] == ["1", "11", "21"]
    assert lines[0] == "compiling the control stack for this machine, once: functions compiled so far: 1, 2 s"


def test_the_share_of_a_run_is_said_once_it_is_known() -> None:
    out, parts = io.StringIO(), [None, (33, 200)]
    line = CompilationLine(out, lambda: parts.pop(0), clock=lambda: 20.0 * (2 - len(parts)))
    line(now(5, 2.0))
    line(now(6, 15.0))
    assert out.getvalue().endswith("once: 16 % of 200 functions, 15 s\n")


def test_on_a_terminal_the_line_changes_and_goes_away() -> None:
    out = Terminal()
    line = CompilationLine(out)
    line(now(1, 2.0))
    line(now(2, 3.0, going_on=False))
    assert out.getvalue().startswith("\r\x1b[Kcompiling")
    assert out.getvalue().endswith("\r\x1b[K")
    assert "\n" not in out.getvalue()


def test_that_machine_code_cannot_be_kept_is_said_once() -> None:
    out = io.StringIO()
    line = CompilationLine(out)
    for _ in range(3):
        line(now(1, 0.1, unwritable="it cannot be kept"))
    assert out.getvalue() == "warning: it cannot be kept\n"


def test_watchers_are_told_of_what_is_compiled_and_of_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))  # an earlier run of this test left its code
    monkeypatch.setattr(module, "cache_folder", module.cache_folder.__wrapped__)
    told: list[Compilation] = []
    watchers.append(told.append)
    try:
        double = compiled(lambda x: 2.0 * x)
        assert not told
        double(1.0)
        count = len(told)
        double(2.0)
    finally:
        watchers.pop()
    assert count == len(told) == 1
    assert not told[0].going_on
    assert told[0].seconds > 0.0
    assert 0 < told[0].ready <= len(module._functions)
