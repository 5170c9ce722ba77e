"""The page and the JSON of the changes between two reports, which lie beside the later report's folder."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from safety_harness.base.exceptions import OutputError
from safety_harness.base.whole_file import write_whole
from safety_harness.extensions.assurance.certification.delta import EvidenceDelta, interval
from safety_harness.extensions.assurance.certification.delta_parts import NONE
from safety_harness.extensions.assurance.certification.verdicts import percent
from safety_harness.extensions.pages.page_parts import render_page

PAGE, JSON = "delta.html", "delta.json"


def folder_of_delta(report: Path) -> Path:
    """Return the folder for a comparison, which lies beside the folder ``report``.

    Inside the report, the folder would contain files that the manifest does not list.
    """
    return report.with_name(f"{report.name}.delta")


def write_delta(folder: Path, delta: EvidenceDelta, *, command: str, generated_at: datetime) -> None:
    """Write the page and the JSON of a comparison.

    If the function fails, it leaves no partial file.

    Args:
        folder: The folder of both files.
        delta: The comparison.
        command: The command that makes the comparison again. The page shows this command.
        generated_at: The time that the page states.

    Raises:
        OutputError: A file cannot be written.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / JSON, delta.as_text())
        write_whole(folder / PAGE, render(delta, command=command, generated_at=generated_at))
    except OSError as error:
        raise OutputError.from_os_error(folder, error) from error


def render(delta: EvidenceDelta, *, command: str, generated_at: datetime) -> str:
    """Return the page of ``delta`` as text.

    The page states the time ``generated_at``, and the ``command`` that creates the page again.
    """
    return render_page(
        "delta.html.j2",
        package="safety_harness.extensions.assurance",
        made=(generated_at, command),
        delta=delta,
        basis=". ".join(delta.bases),
        claims=[
            (
                row.sentence,
                row.stratum or "all",
                row.before.value if row.before else NONE,
                row.after.value if row.after else NONE,
                *(
                    NONE if target is None else percent(target)
                    for target in (row.target_before, row.target_after)
                ),
            )
            for row in delta.claims
        ],
        bounds=[
            (
                row.sentence,
                row.stratum,
                interval(row.before),
                interval(row.after),
                "worse" if row.worse else "better" if row.better else "undecided",
                row.how,
            )
            for row in delta.bounds
        ],
        parts=[(row.name, row.part, row.before, row.after) for row in delta.parts],
        carried=[
            (row.what, "carries over" if row.carries else "to be run again", row.why) for row in delta.carried
        ],
    )
