"""The page of results in docs/ is what its JSON says."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_is_written_from_the_json_beside_it() -> None:
    file = ROOT / "paper" / "results_page.py"
    spec = importlib.util.spec_from_file_location("results_page", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = json.loads((ROOT / "docs" / "reproduction-results.json").read_text("utf-8"))
    page = (ROOT / "docs" / "results" / "paper-numbers.md").read_text("utf-8")
    assert "\n".join(module.lines(found)) + "\n" == page
    assert {run["about"]["scale"] for run in found} == {"default"}
    assert [one["name"] for run in found for one in run["results"]][-1] == "sensitivity"
    assert found[0]["about"]["trainings"] >= 5
    assert not any(run["about"]["missing"] for run in found)
