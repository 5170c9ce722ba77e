"""The results of many revisions.

The results are the changed verdicts, the margins, and whether the gate overrules the avoider increasingly
often.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from markupsafe import Markup

from safety_harness.base.exceptions import InputError, Place
from safety_harness.base.proportions import share_words
from safety_harness.base.whole_file import write_whole
from safety_harness.claims.properties.base import SI_UNITS
from safety_harness.extensions.pages.axes import Picture
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.svg import HANDS
from safety_harness.report.machine import FORMAT
from safety_harness.report.words import count_words, with_minus

REPORT = "report.json"
LIKELY_TREND = 0.05  # level of the test; a trend with a smaller p-value counts as growth
WIDTH_PX, HEIGHT_PX, EDGE_PX = 960.0, 240.0, 60.0
_UNITS = {si: unit for unit, si in SI_UNITS.items() if si != "1"}
Claimed = tuple[str, str, str]  # scenario, avoider, claim
Row = dict[str, Any]


@dataclass(frozen=True)
class Revision:
    """A report of a revision.

    ``name`` is the name of the report's folder. ``claims`` has the claims of its runs, and ``overruling`` has
    a pair (overruled, proposals) for each avoider. ``made_at`` is ISO 8601 in UTC, or empty if the report
    does not state the time.
    """

    name: str
    source_hash: str
    claims: dict[Claimed, Row]
    overruling: dict[str, tuple[int, int]]
    basis: str  # basis line of its verdicts
    made_at: str


@dataclass(frozen=True)
class Course:
    """The verdicts of one claim in all revisions that judged it, in the order of the revisions."""

    claimed: Claimed
    found: tuple[tuple[str, Row], ...]  # revision, outcome

    @property
    def turns(self) -> list[tuple[str, str, str]]:
        """A triple (revision, earlier verdict, new verdict) for each revision that changed the verdict."""
        return [
            (name, last["verdict"], now["verdict"])
            for (_, last), (name, now) in zip(self.found, self.found[1:], strict=False)
            if last["verdict"] != now["verdict"]
        ]

    @property
    def unlike(self) -> bool:
        """True if the newest verdict is unexpected and the verdict has changed at least once."""
        newest = self.found[-1][1]
        return newest["verdict"] != newest["expected"] and bool(self.turns)


@dataclass(frozen=True)
class History:
    """All revisions and claims.

    ``growing`` has the names of the avoiders that the gate overrules more and more.
    """

    revisions: tuple[Revision, ...]
    courses: tuple[Course, ...]
    growing: tuple[str, ...]

    @property
    def unlike(self) -> list[Course]:
        """The claims whose verdict has changed and now differs from the expected verdict."""
        return [course for course in self.courses if course.unlike]

    @property
    def sentence(self) -> str:
        """A sentence on all claims and revisions."""
        turned = [course for course in self.courses if course.turns]
        size = f"{count_words(len(self.courses), 'claim', 'claims')} over {len(self.revisions)} revisions"
        text = f"Result of {size}: {len(turned)} turned, {len(self.unlike)} to an unexpected verdict"
        return text + (f"; overruling grows for {', '.join(self.growing)}." if self.growing else ".")


def read_history(folder: Path) -> History:
    """Read every report.json below ``folder``, in the order of their dates.

    Reports of earlier versions have no date. These reports come first, in the order of their folders' names.

    Raises:
        InputError: There are fewer than two reports, or a file is no report of this version.

    """
    files = sorted(
        folder.rglob(REPORT), key=lambda file: _natural(file.parent.relative_to(folder).as_posix())
    )
    if len(files) < 2:
        expected = f"a folder with the {REPORT} of two revisions at least, at any depth"
        raise InputError(place=Place(file=folder), expected=expected, got=str(len(files)))
    revisions = tuple(_revision(file, file.parent.relative_to(folder).as_posix()) for file in files)
    named = dict.fromkeys(key for item in revisions for key in item.claims)
    revisions = tuple(sorted(revisions, key=lambda item: item.made_at))
    courses = tuple(
        Course(key, tuple((item.name, item.claims[key]) for item in revisions if key in item.claims))
        for key in named
    )
    avoiders = dict.fromkeys(name for item in revisions for name in item.overruling)
    return History(revisions, courses, tuple(name for name in avoiders if _grows(shares_of(revisions, name))))


def _natural(name: str) -> list[tuple[int, int | str]]:
    # Numbers sort as numbers: r9 before r10.
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", name) if part]


def _revision(file: Path, name: str) -> Revision:
    try:
        document = json.loads(file.read_text("utf-8"))
        if document["format"] != FORMAT:
            raise KeyError(document["format"])
        claims = {
            (run["scenario"], _tested(run["system"]), row["claim"]): row
            for run in document["runs"]
            for row in run["claims"]
            if {"verdict", "expected", "margin_si", "unit"} <= row.keys()
        }
        overruling = {
            avoider: (row["overruled"], row["proposals"]) for avoider, row in document["overruling"].items()
        }
        basis = str(document.get("basis", "Basis: not stated by this report"))
        sources = dict.fromkeys(run["source_hash"] for run in document["runs"])
        made_at = document.get("made_at", "")
        made_at = made_at and datetime.fromisoformat(made_at).astimezone(UTC).isoformat()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        got = f"{type(error).__name__}: {error}"
        expected = f'a report with format "{FORMAT}"'
        raise InputError(place=Place(file=file), expected=expected, got=got) from error
    return Revision(name, ", ".join(sources), claims, overruling, basis, made_at)


def _tested(system: Row) -> str:
    part = system.get("avoider") or system.get("controller") or {"name": "-"}
    return str(part["name"])


def shares_of(revisions: Sequence[Revision], avoider: str) -> list[tuple[int, int, int]]:
    """Return a triple for each revision in which ``avoider`` made a proposal.

    The triple has the number of the revision, the number of overruled proposals, and the number of all
    proposals.
    """
    rows = ((k, *row.overruling.get(avoider, (0, 0))) for k, row in enumerate(revisions, start=1))
    return [row for row in rows if row[2]]


def _grows(shares: list[tuple[int, int, int]]) -> bool:
    """Return True if the fraction of overruled proposals rises.

    The decision uses a one-sided test of Kendall's tau.
    """
    from scipy.stats import kendalltau

    # Kendall's tau is not defined if all shares are equal.
    if len(shares) < 2 or len({overruled / proposed for _, overruled, proposed in shares}) == 1:
        return False
    order, part = zip(*((k, overruled / proposed) for k, overruled, proposed in shares), strict=True)
    return bool(kendalltau(order, part, alternative="greater").pvalue < LIKELY_TREND)


def write_page(path: Path, history: History, *, command: str, generated_at: datetime) -> None:
    """Write the page of ``history``.

    If the function fails, it leaves no partial page.

    Args:
        path: The file of the page.
        history: The revisions and claims.
        command: The command that makes the page again.
        generated_at: The time that the page states.

    Raises:
        OSError: The page cannot be written.

    """
    revisions = history.revisions
    avoiders = dict.fromkeys(name for row in revisions for name in row.overruling)
    shares = {name: shares_of(revisions, name) for name in avoiders}
    page = render_page(
        "history.html.j2",
        package="safety_harness.extensions.assurance",
        made=(generated_at, command),
        basis=revisions[-1].basis,
        history=history,
        rows=[_row(row) for row in sorted(history.courses, key=lambda row: (not row.unlike, not row.turns))],
        overruling=[
            (name, share_words(*row[0][1:]), share_words(*row[-1][1:]), name in history.growing)
            for name, row in shares.items()
            if row
        ],
        picture=Markup(_picture(shares, len(revisions))) if any(shares.values()) else "",
    )
    write_whole(path, page)


def _row(course: Course) -> Row:
    newest = course.found[-1][1]
    margins = [_margin_words(row) for _, row in course.found]
    return {"course": course, "newest": newest, "first": margins[0], "last": margins[-1]}


def _margin_words(row: Row) -> str:
    margin, unit = row["margin_si"], _UNITS.get(row["unit"])
    if margin is None or isinstance(margin, str):
        return margin or "\u2013"
    return with_minus(unit.margin_text(margin) if unit else f"{margin:+.3g}")


def _picture(shares: dict[str, list[tuple[int, int, int]]], revisions: int) -> str:
    """Return an SVG plot of the fraction of proposals that the gate overruled in each revision."""
    picture = Picture(WIDTH_PX, HEIGHT_PX)
    axes = picture.axes(EDGE_PX, 30.0, WIDTH_PX - 2 * EDGE_PX, HEIGHT_PX - 80.0)
    for number, (name, points) in enumerate((name, row) for name, row in shares.items() if row):
        ink = HANDS[number % len(HANDS)]
        axes.line([k for k, _, _ in points], [100 * n / m for _, n, m in points], ink, width=1.6)
        axes.key(name, ink)
    axes.x.show(1.0, max(2.0, revisions))
    axes.y.show(0.0, 1.0)
    axes.x.label, axes.y.label = "revision", "overruled, %"
    axes.legend()
    return picture.svg(
        prefix="overruled-",
        title="Overruled proposals over the revisions",
        description="A line for each avoider; the table has the first and the last share.",
    )
