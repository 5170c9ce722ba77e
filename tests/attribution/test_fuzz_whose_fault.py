"""fuzz says whose fault what it finds is: in the file, in the terminal, on the page, in findings.json."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.cli.fuzz import fuzz
from safety_harness.extensions.attribution import search_attribution
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.search import session as search_session
from tests.search.short_space import TEXT

AWAY = "proposals lead away to within 10 mm"
TOWARDS = """\
from safety_harness import Proposal


class Towards:
    name = "towards"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + 0.5 * (hand_position_in_base_m - tcp_position_in_base_m))
"""
DISTANCE = "hand distance never below 50 mm"
PURSUES = (
    TEXT.replace("duration: 400 ms", "duration: 3 s")
    .replace("from 0.2 m/s to 2 m/s", "from 0.9 m/s to 1.1 m/s")
    .replace("stop at distance: 50 mm", "stop at distance: 80 mm")
)


@pytest.fixture(autouse=True)
def _little_shrinking(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 4)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.chdir(tmp_path)


def found(text: str, claim: str, budget: int, avoider: str | None = None) -> dict[str, object]:
    Path("space.yaml").write_text(text)
    fuzz(Path("space.yaml"), out=Path("out"), claims=[claim], budget=budget, avoider=avoider, explain="all")
    read: dict[str, object] = json.loads(Path("out/findings.json").read_text())
    return read


def names_in(value: object, but: tuple[str, ...]) -> set[str]:
    """The names of all fields, down to those ``but`` which have other things for names."""
    if isinstance(value, list):
        return set().union(*(names_in(one, but) for one in value))
    if not isinstance(value, dict):
        return set()
    return set(value).union(*(names_in(one, but) for name, one in value.items() if name not in but))


def test_a_fault_of_the_avoider_is_told_wherever_fuzz_says_something(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("mine.py").write_text(TOWARDS)
    data = found(TEXT, AWAY, 8, "mine.py:Towards")
    out, err = capsys.readouterr()
    (file,) = Path("out").glob("*.yaml")
    comment = next(line for line in file.read_text().splitlines() if line.startswith("# whose fault: "))
    assert comment.startswith("# whose fault: avoider (")
    assert "# in PyBullet, avoider (" in file.read_text()
    assert comment.removeprefix("# ") in out
    attributed, all_of_them = data["attribution_of_counterexamples"], data["attribution"]
    assert isinstance(attributed, dict)
    assert isinstance(all_of_them, dict)
    assert attributed[file.name]["ingredients"] == ["avoider"]
    assert attributed[file.name]["claim"] == AWAY
    distinct = data["distinct"]
    assert isinstance(distinct, list)
    assert all_of_them["groups"] == {"avoider": len(distinct)}
    assert f"of {len(distinct)} groups of violations: {len(distinct)} avoider" in err
    maps = (
        "refused",
        "groups",
        "would_have_helped",
        "coverage",
        "violations_by_cell",
        "overruling",
        "causes",
    )
    names = names_in(data, but=(*maps, "causes", "attribution_of_counterexamples"))
    assert {"nearest_hand_m", "groups_of_violations", "least_sets"} <= names
    assert [name for name in names if not re.fullmatch("[a-z0-9_]+", name)] == []
    page = Path("out/fuzz.html").read_text()
    assert page.count("whose fault: avoider (") >= 2  # in the section, and in the file's text
    assert f"{len(distinct)} avoider" in page  # the picture's description
    assert "Would have helped" in page


def test_one_planted_cause_is_one_finding_in_the_terminal_and_on_the_page(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("mine.py").write_text(TOWARDS)
    Path("space.yaml").write_text(TEXT)
    claims = [AWAY, "proposals within 60 mm of the optimum", "at most 50 % of proposals overruled"]
    fuzz(
        Path("space.yaml"), out=Path("out"), claims=claims, budget=8, avoider="mine.py:Towards", explain="all"
    )
    files = json.loads(Path("out/findings.json").read_text())["counterexamples"]
    assert len(files) == 3
    ((change, mended),) = json.loads(Path("out/findings.json").read_text())["causes"].items()
    assert sorted(mended) == sorted(files)
    out, err = capsys.readouterr()
    assert "VIOLATED  1 cause explained; " in out
    assert f"one cause of 3 examples: {change}: {', '.join(mended)}" in err
    page = Path("out/fuzz.html").read_text()
    assert "1 cause explained. Each of the 3 examples below is repeated in " in page
    assert f"One cause explains 3 examples: <strong>{change}</strong>. It also explains" in page


def test_a_hand_that_pursues_the_arm_is_called_unavoidable(capsys: pytest.CaptureFixture[str]) -> None:
    data = found(PURSUES, DISTANCE, 4)
    assert "whose fault: unavoidable" in capsys.readouterr().out
    attribution = data["attribution"]
    assert isinstance(attribution, dict)
    assert list(attribution["groups"]) == ["unavoidable"]


def test_of_many_violations_some_are_attributed_and_that_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)
    data = found(PURSUES, DISTANCE, 24)
    attribution, distinct = data["attribution"], data["distinct"]
    assert isinstance(attribution, dict)
    assert isinstance(distinct, list)
    assert len(distinct) > 1
    assert (attribution["attributed"], attribution["groups_of_violations"]) == (1, len(distinct))
    assert f"whose fault, of 1 of {len(distinct)} groups of violations" in capsys.readouterr().err


def test_ctrl_c_while_all_are_attributed_keeps_what_was_said_until_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SearchAttribution, "_of_run", interrupted)
    data = found(PURSUES, DISTANCE, 4)
    assert data["interrupted"]
    assert data["counterexamples"]
    attribution = data["attribution"]
    assert isinstance(attribution, dict)
    assert attribution["attributed"] == 0
    assert "until an interruption" in Path("out/fuzz.html").read_text()
