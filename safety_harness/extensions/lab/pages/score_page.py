"""A self-contained HTML page about scored avoiders, in the style of the reports."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from markupsafe import Markup

from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.measures import gained_m, off_m, optimum_in_base_m
from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
from safety_harness.extensions.lab.pages.question_maps import VIEWS, Scale, key_of, question_map
from safety_harness.extensions.lab.pages.score_document import sentence
from safety_harness.extensions.lab.pages.score_tables import (
    COLUMNS,
    DETAILS,
    change_words,
    details,
    figures,
    interval,
    is_green,
    mm,
    repeat_words,
    rows_of,
    times_words,
    towards_words,
)
from safety_harness.extensions.lab.scoring.results import Scored, ScoredAvoider, ShownQuestion
from safety_harness.extensions.lab.scoring.scorecard import RegionScore
from safety_harness.extensions.pages.page_parts import MOST_OPEN, render_page
from safety_harness.report.words import point_words
from safety_harness.scenario.files import display_path

FAR = Scale(
    (0.01, 0.02, 0.04, 0.06),
    ("under 10 mm off", "10 to 20 mm", "20 to 40 mm", "40 to 60 mm", "60 mm and more"),
)
# The first limit separates a share of 0 from any larger share.
TOWARDS = Scale(
    (1e-9, 0.1, 0.5), ("0 % lead towards the hand", "under 10 %", "10 to 50 %", "half or more"), shares=True
)


@dataclass(frozen=True, kw_only=True)
class ScoreEvidence:
    """The content of the page; ``command`` is the command line that repeats the session."""

    scored: Scored
    command: str
    generated_at: datetime


def render(evidence: ScoreEvidence) -> str:
    """Return the text of the page, which depends only on ``evidence``."""
    scored = evidence.scored
    return render_page(
        "score.html.j2",
        package="safety_harness.extensions.lab",
        basis=BASIS_OF_ANSWERS,
        style="score.css",
        e=evidence,
        s=scored,
        answer=sentence(scored),
        most_open=MOST_OPEN,
        columns=COLUMNS,
        details_columns=DETAILS,
        sections=[_section(avoider, number) for number, avoider in enumerate(scored.avoiders, start=1)],
        keys=[Markup(key_of(scale)) for scale in (FAR, TOWARDS)],
        version=installed_version(),
        source=source_hash(),
    )


def _section(scored: ScoredAvoider, number: int) -> dict[str, object]:
    """Return the page's content for one avoider."""
    card, cards = scored.card, [scored.card, *scored.yardsticks]
    return {
        "id": f"avoider-{number}",
        "one": scored,
        "towards": towards_words(scored.card),
        "green": is_green(scored.card),
        "rows": list(rows_of(cards, figures)),
        "details": list(rows_of(cards, details)),
        "regions": [
            (score, _description(score), list(_maps(score, settings, f"m{number}-{k}-")))
            for k, (score, settings) in enumerate(zip(card.regions, scored.settings, strict=False))
        ],
        "jumps": [
            (jumps.region, jumps.moved.value, [change_words(c) for c in (jumps.largest, jumps.steepest) if c])
            for jumps in card.jumps
        ],
        "repeats": [(repeat.way.value, repeat_words(repeat), repeat.differ > 0) for repeat in card.repeats],
        "times": times_words(card),
        "worst": [_worst_row(k, shown) for k, shown in enumerate(scored.worst, start=1)],
        "searched": sum(search.asked for search in scored.searches),
        "run_command": _run_command(scored),
    }


def _description(score: RegionScore) -> str:
    """Return the description of a region.

    It includes the median and the RMS of the distances from the answers to the optimum.
    """
    if score.off_m is None or score.off_rms_m is None:
        return score.about
    median, rms = interval(score.off_m[0]), interval(score.off_rms_m)
    return f"{score.about}; off the optimum: median {median} mm, rms {rms} mm"


def _maps(score: RegionScore, settings: Settings, prefix: str) -> Iterator[tuple[str, str, Markup]]:
    """Yield the caption, the quantity and the drawing of each map of a region.

    There are eight maps: for each of two quantities, the positions of hands and of TCPs in two views.
    """
    posed = score.questions
    hands, tcps, answers = posed.hands_in_base_m, posed.tcps_in_base_m, score.answers.positions_in_base_m
    if len(posed) == 0:
        return
    error_m = off_m(answers, optimum_in_base_m(settings, hands, tcps))
    gained = gained_m(hands, tcps, answers)
    # A missing answer counts as one towards the hand.
    towards = np.where(np.isnan(gained), 1.0, gained < 0.0)
    maps: tuple[tuple[str, np.ndarray, Scale], ...] = (("off", error_m, FAR), ("towards", towards, TOWARDS))
    for name, values, scale in maps:
        for who, positions in (("hand", hands), ("TCP", tcps)):
            for view in VIEWS:
                yield _map(
                    positions, values, scale, view, f"{prefix}{name}-{who}-{view[1]}-", who, score.region
                )


def _map(
    positions: ArrayNx3,
    values: np.ndarray,
    scale: Scale,
    view: tuple[int, int, str],
    prefix: str,
    who: str,
    region: str,
) -> tuple[str, str, Markup]:
    """Return the caption, the quantity and the drawing of one map."""
    caption = f"{who}, {view[2]}"
    quantity = "towards the hand" if scale.shares else "off the optimum"
    title = f"{region}: {quantity}, by the position of the {who}, {view[2]}"
    return caption, quantity, Markup(question_map(positions, values, scale, view, prefix=prefix, title=title))


def _worst_row(number: int, shown: ShownQuestion) -> dict[str, object]:
    """Return the values in the page's table row for one worst question."""
    tried, file = shown.tried, shown.file
    return {
        "number": number,
        "what": shown.objective.value,
        "region": tried.region,
        "hand": point_words(tried.hand_in_base_m),
        "tcp": point_words(tried.tcp_in_base_m),
        "gained": mm(tried.gained_m),
        "optimum_gained": mm(tried.optimum_gained_m),
        "off": mm(tried.off_m),
        "sure": "sure" if tried.sure else "in doubt",
        "file": "" if file.path is None else file.path.name,
        "claims": [f"{claim.sentence}: {claim.expected.value}" for claim in file.claims],
    }


def _run_command(scored: ScoredAvoider) -> str:
    """Return the command line that runs the scenario files of all worst questions."""
    paths: list[Path] = [shown.file.path for shown in scored.worst if shown.file.path is not None]
    return (
        shlex.join(["safety-harness", "run", *(str(display_path(path)) for path in paths)]) if paths else ""
    )
