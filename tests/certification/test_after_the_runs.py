"""Nothing that happens after the runs of a plan loses its report."""

from __future__ import annotations

from typing import Any

import pytest

from safety_harness.certification import whose_fault as module
from safety_harness.report.search_attribution import SearchAttribution


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
