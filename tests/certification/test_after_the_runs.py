"""Nothing that happens after the runs of a plan loses its report."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from safety_harness.certification import gather, page
from safety_harness.certification import whose_fault as module
from safety_harness.report.search_attribution import SearchAttribution
from tests.certification.made_up_evidence import evidence


def test_what_cannot_be_attributed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """The program of the plan cannot be made again: the page says so in place of whose fault it is."""

    def broken(*_: object, **__: object) -> Any:
        raise FileNotFoundError("still.py")

    monkeypatch.setattr(module, "violated_episodes", broken)
    monkeypatch.setattr(module.ViolatedEpisodes, "first", broken_free)
    found = module.whose_fault(None, None)  # type: ignore[arg-type]
    assert found.about.startswith(module.UNTOLD)
    assert "still.py" in found.about


def broken_free(*_: object) -> Any:
    return module.ViolatedEpisodes({}, 0)


def test_a_scenario_that_cannot_be_admitted_again_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    attribution = SearchAttribution()

    def refused(_: object) -> Any:
        raise FileNotFoundError("still.py")

    monkeypatch.setattr(attribution._admitter, "admit", refused, raising=False)
    (line,) = attribution.explain(None, None)  # type: ignore[arg-type]
    assert line.startswith("whose fault: cannot be told")


def test_a_picture_that_cannot_be_made_is_open_on_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """The counterexample stays, without pictures, and says why."""

    def broken(*_: object, **__: object) -> Any:
        raise ValueError("no such mesh")

    monkeypatch.setattr(page, "_pictures", broken)
    run = SimpleNamespace(trace=SimpleNamespace(ticks=[0]), under=lambda _: run)
    one = evidence().counterexamples[0]
    view = page._counterexample(one, run, page.Replays())  # type: ignore[arg-type]
    assert view["run"] is None
    assert "no such mesh" in view["one"].lines[-1]  # type: ignore[attr-defined]


def test_what_fails_after_the_runs_is_an_open_finding() -> None:
    """Any exception counts: a user's program may raise anything."""
    guard = gather._Guard()
    assert guard.of("one", lambda: 1, 0) == 1
    assert guard.of("the table", lambda: 1 // 0, 0) == 0
    assert guard.open == ["the table cannot be made: ZeroDivisionError: integer division or modulo by zero"]
