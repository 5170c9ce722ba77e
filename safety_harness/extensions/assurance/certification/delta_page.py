"""The page and the JSON of what changed between two reports, beside the later one's folder."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from safety_harness.base.exceptions import OutputError
from safety_harness.base.whole_file import write_whole
from safety_harness.extensions.assurance.certification.delta import EvidenceDelta, interval
from safety_harness.extensions.assurance.certification.delta_parts import NONE
from safety_harness.extensions.assurance.certification.verdicts import percent
from safety_harness.report.page_parts import render_page

PAGE, JSON = "delta.html", "delta.json"


def folder_of_delta(report: Path) -> Path:
    """Beside the report: within it would be a file more than its manifest has."""
    return report.with_name(f"{report.name}.delta")


def write_delta(folder: Path, delta: EvidenceDelta, *, command: str, generated_at: datetime) -> None:
    """Both files, each whole or not at all; OutputError for what cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / JSON, delta.as_text())
        write_whole(folder / PAGE, render(delta, command=command, generated_at=generated_at))
    except OSError as error:
        raise OutputError.of(folder, error) from error


def render(delta: EvidenceDelta, *, command: str, generated_at: datetime) -> str:
    """The page as text."""
    return render_page(
        "delta.html.j2",
        of="safety_harness.extensions.assurance",
        made=(generated_at, command),
        delta=delta,
        basis=". ".join(delta.bases),
        claims=[
            (
                one.sentence,
                one.stratum or "all",
                one.before.value if one.before else NONE,
                one.after.value if one.after else NONE,
                *(
                    NONE if target is None else percent(target)
                    for target in (one.target_before, one.target_after)
                ),
            )
            for one in delta.claims
        ],
        bounds=[
            (
                one.sentence,
                one.stratum,
                interval(one.before),
                interval(one.after),
                "worse" if one.worse else "better" if one.better else "not told apart",
                one.how,
            )
            for one in delta.bounds
        ],
        parts=[(one.name, one.part, one.before, one.after) for one in delta.parts],
        carried=[
            (one.what, "carries over" if one.carries else "has to be run again", one.why)
            for one in delta.carried
        ],
    )
