"""The results as JSON, with all that is on the page."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any

from safety_harness.base.whole_file import write_whole
from safety_harness_paper.choices import CHOICES
from safety_harness_paper.result import FigureComparison, Result, estimate_words

FORMAT = "safety-harness reproduction 1"


@dataclass(frozen=True, kw_only=True)
class About:
    """How the results came about; ``missing`` are parts that could not be finished, and why."""

    scale: str
    seed: int
    trainings: int
    command: str
    package_version: str
    source_hash: str
    software: tuple[tuple[str, str], ...]
    platform: str
    generated_at: datetime
    keys: tuple[tuple[str, str], ...]  # label and key of every measurement
    missing: tuple[tuple[str, str], ...] = ()


def document(results: Sequence[Result], about: About) -> dict[str, Any]:
    """Plain JSON; a number that is not finite is null."""
    return {
        "format": FORMAT,
        "about": _plain(asdict(about)) | {"generated_at": about.generated_at.isoformat()},
        "choices": [list(one) for one in CHOICES],
        "results": [_result(one) for one in results],
    }


def write_document(path: Path, results: Sequence[Result], about: About) -> None:
    """Whole or not at all.  Raises OSError."""
    write_whole(
        path, json.dumps(document(results, about), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    )


def comparison_words(one: FigureComparison) -> tuple[str, str, str]:
    """The paper's figure, ours with its interval, and whether they agree, as texts."""
    paper = "\u2013"
    if one.paper is not None:
        rounded = f"{one.paper:.{one.digits}f}"
        paper = rounded if float(rounded) == one.paper else f"{one.paper:g}"  # none of its digits is lost
        paper += f" {one.unit}" if one.unit else ""
    ours = estimate_words(one.ours, unit=one.unit, scale=one.scale, digits=one.digits)
    agrees = {None: "\u2013" if one.paper is None else "not compared", True: "yes", False: "no"}[one.agrees]
    return paper, ours, agrees


def _result(one: Result) -> dict[str, Any]:
    plain = _plain(asdict(one))
    for row, comparison in zip(plain["comparisons"], one.comparisons, strict=True):
        row["agrees"] = comparison.agrees
        row["paper_words"], row["ours_words"], row["agrees_words"] = comparison_words(comparison)
    return dict(plain)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, datetime):
        return value.isoformat()
    assert not is_dataclass(value)
    return value
