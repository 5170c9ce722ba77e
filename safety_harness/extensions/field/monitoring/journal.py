"""The monitor's own log: folders of limited size, each with tables of the used samples and a LOG.yaml.

    OUT/0001/{LOG.yaml, joints.csv, hand-1.csv}, OUT/0002/...

The journal writes each row completely and at once, so ``judge`` can read the log even after the process was
killed. A new folder begins with the last sample of each table, so that no motion between two samples is lost.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from safety_harness.base.exceptions import OutputError
from safety_harness.extensions.field.monitoring.cell import WatchedCell

Place = tuple[float, ...] | None
JOINTS = "joints.csv"


@dataclass(kw_only=True)
class Journal:
    """A writer of the monitor's log below ``folder``.

    Each part is a folder of at most ``most_bytes``; the journal deletes all but the last ``keep`` parts. It
    raises OutputError if ``folder`` is not empty or cannot be written.
    """

    cell: WatchedCell
    claims: Sequence[str]
    folder: Path
    most_bytes: int
    keep: int
    part: int = 0
    _files: dict[str, int] = field(default_factory=dict)
    _last: dict[str, bytes] = field(default_factory=dict)
    _room: int = 0

    def __post_init__(self) -> None:
        if self.folder.exists() and any(self.folder.iterdir()):
            raise OutputError.of_file(self.folder, "an empty folder, or none yet", "files in it")
        self._names = {hand.name: f"hand-{k}.csv" for k, hand in enumerate(self.cell.hands, start=1)}
        self._begin()

    def joints(
        self, time_ns: int, position_rad: Sequence[float], rates_radps: Sequence[float] | None
    ) -> None:
        """Write one sample of the joints.

        The sample includes speeds only if the description of the cell states their uncertainty.
        """
        known = self.cell.joint_facts.speeds_known_to_radps is not None
        self._write(JOINTS, time_ns, (*position_rad, *((rates_radps or ()) if known else ())))

    def hand(self, name: str, time_ns: int, hand_m: Place, elbow_m: Place) -> None:
        """Write one sample of the hand ``name``, with empty cells for a position that was not measured."""
        nothing = (None,) * 3
        elbow = (elbow_m or nothing) if self._elbows[name] else ()
        self._write(self._names[name], time_ns, (*(hand_m or nothing), *elbow))

    def close(self) -> None:
        """Close the files of the present part."""
        for file in self._files.values():
            os.close(file)
        self._files.clear()

    @property
    def latest(self) -> Path:
        """Return the path of the LOG.yaml in the present part."""
        return self.folder / f"{self.part:04d}" / "LOG.yaml"

    @property
    def _elbows(self) -> dict[str, bool]:
        return {hand.name: hand.elbow for hand in self.cell.hands}

    def _write(self, name: str, time_ns: int, values: Sequence[float | None]) -> None:
        row = ",".join(
            [str(time_ns), *("" if value is None else repr(float(value)) for value in values)]
        ).encode()
        row += b"\n"
        if self._room < len(row):
            self._begin()
        self._last[name] = row
        self._put(name, row)

    def _put(self, name: str, row: bytes) -> None:
        try:
            if os.write(self._files[name], row) < len(row):
                raise OSError("no room for a whole row")
        except OSError as error:
            expected = "room for the monitor's log"
            raise OutputError.of_file(
                self.folder / f"{self.part:04d}" / name, expected, str(error)
            ) from error
        self._room -= len(row)

    def _begin(self) -> None:
        """Begin the next part, and delete the oldest part if more than ``keep`` would remain."""
        self.close()
        self.part += 1
        folder = self.folder / f"{self.part:04d}"
        headers = {JOINTS: self._header_of_joints()}
        for name, file in self._names.items():
            tracks = ("hand", "elbow") if self._elbows[name] else ("hand",)
            headers[file] = ",".join(
                ["time_ns", *(f"{track}_{axis}_m" for track in tracks for axis in "xyz")]
            )
        try:
            folder.mkdir(parents=True)
            text = self.cell.log_text(JOINTS, tuple(self._names.values()), self.claims)
            (folder / "LOG.yaml").write_text(text, "utf-8")
            for name in headers:
                self._files[name] = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
            if self.part > self.keep:
                shutil.rmtree(self.folder / f"{self.part - self.keep:04d}", ignore_errors=True)
        except OSError as error:
            raise OutputError.of_file(folder, "a folder that can be written", str(error)) from error
        self._room = self.most_bytes
        # The last row of each stream begins the next part, so that every part is a log by itself.
        for name, header in headers.items():
            self._put(name, header.encode() + b"\n" + self._last.get(name, b""))

    def _header_of_joints(self) -> str:
        names = self.cell.arm.joint_names
        columns = [f"{name}_rad" for name in names]
        if self.cell.joint_facts.speeds_known_to_radps is not None:
            columns += [f"{name}_radps" for name in names]
        return ",".join(["time_ns", *columns])
