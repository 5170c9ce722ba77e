"""Traces on disk: one zip of plain arrays and JSON, loaded without execution of its contents.

A file contains the scenario's text with exact values, its recordings, and the files of a user's own arm. It
also contains ticks, decisions and provenance, and a hash over all of that. It contains no pickle. The hashes
reveal accidental damage. They do not reveal forgery, because an editor of a file can write new hashes. So the
reader also refuses traces that contradict themselves. Only a repetition of the run shows whether the rest is
true.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import struct
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InputError, Place, TraceError, refuse_other_type
from safety_harness.base.shipped.contents import located
from safety_harness.base.whole_file import replacing
from safety_harness.scenario.faults import AvoiderLate, AvoiderSilent, Fault
from safety_harness.scenario.files import as_path, display_path, refuse_no_file
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.model import EDITION, MAX_HANDS, RecordedHand, Scenario
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.recording import MAX_BYTES
from safety_harness.scenario.references import portable, with_file
from safety_harness.scenario.robots import OwnRobot
from safety_harness.scenario.typed_json import parsed, plain, typed
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.certified import CertifiedDecisions
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.known import WHOLLY_KNOWN, Knowledge, Measurement
from safety_harness.trace.records import (
    DECISION,
    INTERVENTION,
    decision_dtype,
    filtered_dtype,
    intervention_dtype,
    predicted_dtype,
    tick_dtype,
)
from safety_harness.trace.system import Component, Line, SystemUnderTest, system_of
from safety_harness.trace.trace import (
    Provenance,
    Trace,
    no_interventions,
    not_filtered,
    not_predicted,
    not_recorded,
)

FORMAT = "safety-harness trace 4"
IN_PART = "safety-harness trace 5"  # this format states what is known of its columns; others know all
EARLIER_FORMAT = "safety-harness trace 3"  # its decisions do not state when the avoider was asked
HEADER = "trace.json"
SMALL_BYTES = 4_000_000  # of a part that is text; arrays are as long as the scenario lasts
ARRAY_HEADER_BYTES = 20_000  # room for the header of an array
KNOWN = "known.json"
CERTIFIED = "certified.json"  # only if a user asked for proofs
INTERVENTIONS = "interventions.npy"  # only for a scenario with a shield
FILTERED = "filtered.npy"  # only for a scenario with a safety filter
PREDICTED = "predicted.npy"  # only for a scenario with a predictor
OVERSHOOT = "overshoot.npy"  # only where an engine's sub-steps were recorded
CARRIED = ("recordings/", "robot/")  # files of the scenario by their SHA-256
MOST_PARTS = 12 + MAX_HANDS
ZIP_END = struct.Struct("<4s4H2LH")  # without a comment, as it is written here
OF_AVOIDER = ("avoider", "avoider_sha256")  # in the provenance, before the system was a record
NEW = ("asked_tick", "decision_time_s")
# The record of a decision in EARLIER_FORMAT, which lacks the fields NEW.
DECISION_3 = np.dtype(
    [(name, field[0]) for name, field in (DECISION.fields or {}).items() if name not in NEW], align=True
)


T = TypeVar("T")


@dataclass(frozen=True)
class _Header:
    format: str
    sha256: dict[str, str]


@dataclass(frozen=True)
class _Run:
    scenario_name: Line
    scenario_file: Line | None
    ended: Line
    provenance: Provenance
    system: SystemUnderTest | None = None  # None in a trace of an earlier version
    claims: int = 1  # the edition of the catalogue that defines the claims


def save_trace(trace: Trace, path: str | Path, recordings: Mapping[str, bytes] | None = None) -> None:
    """Write ``trace`` to ``path``, completely or not at all.

    Args:
        trace: The trace.
        path: The file to write.
        recordings: The bytes of recorded motions by sha256. A missing recording is read from the file that
            the scenario names. None: all recordings are read from their files.

    Raises:
        OSError: The file cannot be written.
        TraceError: A recording has changed since the scenario was read.

    """
    refuse_other_type("save_trace(trace)", trace, Trace)
    path = as_path(path, "save_trace(path)")
    # With all settings, since another version may have other defaults.
    text = write_scenario(_portable(trace.scenario), all_settings=True)
    parts: dict[str, bytes] = {"scenario.yaml": text.encode()}
    arrays = {
        "ticks.npy": _fields_alone(trace.ticks),
        "decisions.npy": _fields_alone(trace.decisions),
        "latencies.npy": trace.decision_latency_s,
    }
    if trace.scenario.shield is not None:
        arrays[INTERVENTIONS] = _fields_alone(trace.interventions)
    if trace.scenario.safety_filter:
        arrays[FILTERED] = _fields_alone(trace.filtered)
    if trace.scenario.predictor:
        arrays[PREDICTED] = _fields_alone(trace.predicted)
    if len(trace.overshoot_radps):
        arrays[OVERSHOOT] = trace.overshoot_radps.ravel()
    for name, array in arrays.items():
        buffer = io.BytesIO()
        # A pickle could execute code when it is loaded.
        np.lib.format.write_array(buffer, array, allow_pickle=False)
        parts[name] = buffer.getvalue()
    for hand in trace.scenario.hands:
        if isinstance(hand, RecordedHand):
            digest = hand.motion.sha256
            known = (recordings or {}).get(digest)
            parts[f"recordings/{digest}.csv"] = (
                known if known is not None else _recording(trace.scenario, hand)
            )
    if isinstance(trace.scenario.robot, OwnRobot):
        parts |= {f"robot/{digest}": text for digest, text in trace.scenario.robot.texts.items()}
    run = {
        "scenario_name": trace.scenario.name,
        "scenario_file": str(display_path(trace.scenario.file)) if trace.scenario.file else None,
        "ended": trace.ended,
        "provenance": asdict(trace.provenance),
        "system": trace.system.as_dict,
        "claims": min((claim.edition for claim in trace.scenario.claims), default=EDITION),
    }
    parts["run.json"] = json.dumps(run, indent=1, sort_keys=True).encode()
    if not (trace.known.simulated and trace.known.whole):
        columns = {n: {**asdict(how), "source": how.source.value} for n, how in trace.known.columns.items()}
        parts[KNOWN] = json.dumps(columns, indent=1, sort_keys=True).encode()
    if trace.certified is not None:
        parts[CERTIFIED] = json.dumps(plain(trace.certified), indent=1, sort_keys=True).encode()
    # The header comes last, because it has the hashes of all other parts.
    header = {
        "format": IN_PART if KNOWN in parts else FORMAT,
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(parts.items())},
    }
    parts["trace.json"] = json.dumps(header, indent=1, sort_keys=True).encode()
    with (
        replacing(path) as unfinished,
        zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED, compresslevel=2) as archive,
    ):
        for name in sorted(parts):
            # ZipInfo has a constant date, so that equal traces are equal files.
            archive.writestr(zipfile.ZipInfo(name), parts[name], zipfile.ZIP_DEFLATED, 2)


def _fields_alone(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return the records with zeros in the bytes between their fields.

    Otherwise these bytes would have arbitrary values.
    """
    clean = np.zeros(records.shape, records.dtype)
    for name in records.dtype.names or ():
        clean[name] = records[name]
    return clean


def _portable(scenario: Scenario) -> Scenario:
    """Return the scenario with every path that exists only on this machine replaced by a portable name."""
    folder = scenario.file.parent if scenario.file else Path()

    def name(path: str) -> str:
        return portable(path, folder)

    return replace(
        scenario.with_files(name),
        avoider=with_file(scenario.avoider, name),
        controller=with_file(scenario.controller, name),
        safety_filter=with_file(scenario.safety_filter, name),
        predictor=with_file(scenario.predictor, name),
    )


def _recording(scenario: Scenario, hand: RecordedHand) -> bytes:
    """Return the bytes of a recording.

    Raise TraceError if its file has changed since the scenario was read.
    """
    folder = scenario.file.parent if scenario.file else Path()
    data = located(folder / hand.recording).read_bytes()
    if hashlib.sha256(data).hexdigest() != hand.motion.sha256:
        expected = f"the recording that the scenario was read with (sha256 {hand.motion.sha256[:12]}...)"
        raise TraceError.of_file(folder / hand.recording, expected, "a file that has changed since")
    return data


def load_trace(path: str | Path) -> Trace:
    """Read a trace.

    Args:
        path: The file that ``save_trace`` wrote.

    Raises:
        TraceError: The file is no trace, is damaged, or contradicts itself.

    """
    path = as_path(path, "load_trace(path)")
    refuse_other_kind(path, FileKind.TRACE, error=TraceError)
    return _Reader(path).trace()


class _Reader:
    """The reader of one trace file; each of its errors states the file.

    It unpacks no part that is larger than allowed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts: dict[str, bytes] = {}
        self._hashes: dict[str, str] = {}
        self._format = FORMAT

    def trace(self) -> Trace:
        try:
            refuse_no_file(self._path, "a trace file", TraceError)
            with self._path.open("rb") as file:
                self._refuse_no_directory(file)
                with zipfile.ZipFile(file) as archive:
                    return self._trace(archive)
        except TraceError:
            raise
        except Exception as error:  # zlib.error, struct.error: whatever damaged bytes provoke
            raise self._error("a trace file, whole", _in_words(error)) from error

    def _trace(self, archive: zipfile.ZipFile) -> Trace:
        """Return the trace.

        The small parts are read first, because they limit the sizes of the large parts.
        """
        first = min((info.header_offset for info in archive.infolist()), default=0)
        if first:  # what lies before would not be read
            raise self._error("one trace alone in the file", f"{first} bytes before it")
        for info in archive.infolist():
            if info.filename in self._parts:
                raise self._error("each part once", "one twice", info.filename)
            self._parts[info.filename] = b""
        self._check_header(archive)
        carried = [name for name in self._parts if name.startswith(CARRIED)]
        for name in ("run.json", "scenario.yaml", *carried):
            self._unpack(archive, name, SMALL_BYTES if name not in carried else MAX_BYTES)
        run, avoider = self._run()
        scenario = self._scenario(run)
        most = scenario.ticks + 1
        old = self._format == EARLIER_FORMAT
        joints = len(
            scenario.settings.cell.preferred_joint_position_rad
        )  # one for each, as admission ensures
        decision = DECISION_3 if old else decision_dtype(joints)
        decisions = self._array(archive, "decisions.npy", decision, most)
        ticks = self._array(archive, "ticks.npy", tick_dtype(scenario.hand_slots, joints), most)
        if old:
            decisions = as_now(decisions, ticks, scenario.faults)
        latencies_s = self._array(archive, "latencies.npy", np.dtype(np.float64), most)
        if len(latencies_s) != len(decisions):
            raise self._error(f"{len(decisions)}, one a decision", str(len(latencies_s)), "latencies.npy")
        interventions = no_interventions()
        if scenario.shield is not None:
            dtype = intervention_dtype(scenario.hand_slots, joints)
            interventions = self._array(archive, INTERVENTIONS, dtype, most, INTERVENTION)
            if len(interventions) != len(ticks):
                raise self._error(f"{len(ticks)}, one a tick", str(len(interventions)), INTERVENTIONS)
        filtered, predicted = not_filtered(), not_predicted()
        if scenario.safety_filter:
            filtered = self._one_a_tick(archive, FILTERED, filtered_dtype(joints), most, len(ticks))
        if scenario.predictor:
            dtype = predicted_dtype(scenario.hand_slots)
            predicted = self._one_a_tick(archive, PREDICTED, dtype, most, len(ticks))
        overshoot_radps = not_recorded()
        if OVERSHOOT in self._parts:
            overshoot_radps = self._array(archive, OVERSHOOT, np.dtype(np.float64), joints * most)
            if len(overshoot_radps) != joints * len(ticks) or not (overshoot_radps >= 0.0).all():
                expected = f"{joints * len(ticks)} speeds, none below 0"
                raise self._error(expected, f"{len(overshoot_radps)}, or one below 0", OVERSHOOT)
            overshoot_radps = overshoot_radps.reshape(-1, joints)
        known = WHOLLY_KNOWN
        if self._format == IN_PART or KNOWN in self._parts:
            self._unpack(archive, KNOWN, SMALL_BYTES)
            known = self._known(ticks, len(scenario.hands))
        certified = None
        if CERTIFIED in self._parts:
            self._unpack(archive, CERTIFIED, SMALL_BYTES)
            certified = self._json(CERTIFIED, CertifiedDecisions)
            if len(certified.decisions) != len(decisions):
                raise self._error(f"{len(decisions)} decisions", str(len(certified.decisions)), CERTIFIED)
        trace = Trace(
            scenario=scenario,
            ticks=ticks,
            decisions=decisions,
            decision_latency_s=latencies_s,
            provenance=run.provenance,
            ended=run.ended,
            known=known,
            system=run.system or system_of(scenario, avoider=avoider),
            interventions=interventions,
            filtered=filtered,
            predicted=predicted,
            certified=certified,
            overshoot_radps=overshoot_radps,
        )
        flaw = first_inconsistency(trace)
        if flaw is not None:
            raise self._error(flaw.expected, flaw.got, flaw.where)
        return trace

    def _error(self, expected: str, got: str, field: str | None = None) -> TraceError:
        return TraceError(place=Place(file=self._path, field=field), expected=expected, got=got)

    def _refuse_no_directory(self, file: IO[bytes]) -> None:
        """Refuse a file without a zip end record, or whose zip directory could fill the memory."""
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - ZIP_END.size, 0))
        end = file.read(ZIP_END.size)
        if len(end) < ZIP_END.size or not end.startswith(b"PK\5\6"):
            raise self._error("a trace file, whole", "no end of a zip file")
        _, _, _, _, parts, directory_bytes, _, _ = ZIP_END.unpack(end)
        if parts > MOST_PARTS or directory_bytes > SMALL_BYTES:
            got = f"{parts}, listed in {directory_bytes} bytes"
            raise self._error(f"a trace file of at most {MOST_PARTS} parts", got)

    def _unpack(self, archive: zipfile.ZipFile, name: str, most: int) -> None:
        """Read a part of at most ``most`` bytes, and check its hash."""
        if name not in self._parts:
            raise self._error("a part of this name", "none", name)
        size = archive.getinfo(name).file_size
        if size > most:
            raise self._error(f"at most {most:,} bytes unpacked", f"{size:,}", name)
        try:
            self._parts[name] = archive.read(name)
        except Exception as error:  # zlib.error, struct.error: whatever damaged bytes provoke
            raise self._error("a trace file, whole", _in_words(error), name) from error
        actual = hashlib.sha256(self._parts[name]).hexdigest()
        if name != HEADER and self._hashes[name] != actual:
            raise self._error(f"contents with sha256 {self._hashes[name]}", f"sha256 {actual}", name)

    def _json(self, name: str, kind: type[T]) -> T:
        """Return the part ``name``, a JSON object, as an object of type ``kind``."""
        value = parsed(self._parts[name], self._path, name, TraceError)
        return typed(value, kind, self._path, defaults=True, error=TraceError)

    def _run(self) -> tuple[_Run, Component | None]:
        """Return the record of the run, and an avoider or None.

        The result contains an avoider only if an earlier version wrote the file, because that version stored
        an avoider instead of the system.
        """
        record, avoider = parsed(self._parts["run.json"], self._path, "run.json", TraceError), None
        made = record.get("provenance") if isinstance(record, dict) else None
        if isinstance(made, dict) and "system" not in record and OF_AVOIDER[0] in made:
            values = zip(("name", "sha256"), (made.pop(name, "") for name in OF_AVOIDER), strict=True)
            avoider = typed(dict(values), Component, self._path, where="provenance.avoider", error=TraceError)
        elif isinstance(record, dict) and "system" not in record:
            raise self._error("this field", "none", "system")
        return typed(record, _Run, self._path, defaults=True, error=TraceError), avoider

    def _known(self, ticks: NDArray[np.void], hands: int) -> Knowledge:
        try:
            entries = self._json(KNOWN, dict[str, Any])
            columns = {
                name: typed(_whole(entry), Measurement, self._path, where=f"known.{name}", error=TraceError)
                for name, entry in entries.items()
            }
            known = Knowledge(columns)
            known.refuse_gaps_beyond(ticks, hands)
        except TraceError as error:
            raise self._error(error.expected, error.got, error.place.field or KNOWN) from error
        return known

    def _check_header(self, archive: zipfile.ZipFile) -> None:
        """Check the file's format, and check that every other part has a hash."""
        self._unpack(archive, HEADER, SMALL_BYTES)
        header = self._json(HEADER, _Header)
        if header.format not in (FORMAT, EARLIER_FORMAT, IN_PART):
            raise self._error(f"the format {FORMAT!r}", repr(header.format), "format")
        self._hashes, self._format = header.sha256, header.format
        for name in sorted(header.sha256.keys() ^ (self._parts.keys() - {HEADER})):
            raise self._error("a hash for each part, a part for each hash", "only one of them", name)

    def _scenario(self, run: _Run) -> Scenario:
        carried = {
            name.partition("/")[2].removesuffix(".csv"): data
            for name, data in self._parts.items()
            if name.startswith(CARRIED)
        }
        name = run.scenario_name
        if "/" in name or name in ("", ".", ".."):
            raise self._error("the name of a scenario, without folders", repr(name), "scenario_name")
        file = Path(run.scenario_file or f"{name}.yaml")
        try:
            text = self._parts["scenario.yaml"].decode()
            read = parse_scenario(text, file, carried, name=name, claims_required=False)
            return replace(read, claims=tuple(replace(c, edition=run.claims) for c in read.claims))
        except UnicodeDecodeError as error:
            raise self._error("a scenario in the trace", f"none that can be read ({error!r})") from error
        except InputError as error:
            raise self._error("a scenario that this version reads", str(error), "scenario.yaml") from error

    def _one_a_tick(
        self, archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], most: int, ticks: int
    ) -> NDArray[Any]:
        """Return the result of ``_array``, after checking that the number of records is ``ticks``."""
        records = self._array(archive, name, dtype, most)
        if len(records) != ticks:
            raise self._error(f"{ticks}, one a tick", str(len(records)), name)
        return records

    def _array(
        self,
        archive: zipfile.ZipFile,
        name: str,
        dtype: np.dtype[Any],
        most: int,
        earlier: np.dtype[Any] | None = None,
    ) -> NDArray[Any]:
        """Return the records of the part ``name``.

        There may be at most ``most`` records. The records have the type ``dtype`` or, in an earlier version,
        the type ``earlier``. The method compares the length in the header with the actual bytes before it
        trusts the header.
        """
        self._unpack(archive, name, most * dtype.itemsize + ARRAY_HEADER_BYTES)
        data = io.BytesIO(self._parts.pop(name))
        try:
            if np.lib.format.read_magic(data) != (1, 0):
                raise ValueError("another version of the format")
            shape, _, stored = np.lib.format.read_array_header_1_0(data)
        except Exception as error:  # whatever its parser stumbles over
            raise self._error("an array of records", f"none that can be read ({error})", name) from error
        dtype = earlier if earlier is not None and stored == earlier else dtype
        if stored != dtype or len(shape) != 1:
            raise self._error("records as this version writes them", f"{stored}", name)
        records = data.read()
        if len(records) != shape[0] * dtype.itemsize:
            raise self._error(f"{shape[0]} records", f"{len(records)} bytes of them", name)
        return np.frombuffer(records, dtype).copy()


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def as_now(decisions: NDArray[np.void], ticks: NDArray[np.void], faults: Sequence[Fault]) -> NDArray[np.void]:
    """Convert decisions of the type DECISION_3 to the type DECISION, both (m,).

    In that earlier version, decisions cost time only if a fault delayed them.
    """
    now = np.zeros(len(decisions), DECISION)
    for name in DECISION_3.names or ():
        now[name] = decisions[name]
    now["asked_tick"] = _asked_at(decisions["tick"], ticks["faults"], faults)
    return now


def _asked_at(at: NDArray[np.int64], acts: NDArray[np.int64], faults: Sequence[Fault]) -> NDArray[np.int64]:
    """Return the tick at which each question was asked, shape (m,).

    While a fault delays an answer, the fault is recorded in all ticks from the question to the decision.
    """
    slow = sum(1 << k for k, fault in enumerate(faults) if isinstance(fault, AvoiderLate | AvoiderSilent))
    waiting = (acts & slow) != 0
    if len(at) == 0 or at.min() < 0 or at.max() >= len(waiting):
        return at  # refused later, in words
    begun = np.maximum.accumulate(np.where(waiting, -1, np.arange(len(waiting)))) + 1
    after_the_one_before = np.concatenate([[0], at[:-1] + 1])
    return np.where(waiting[at], np.maximum(begun[at], after_the_one_before), at)


def _whole(measurement: Any) -> Any:
    """Return the stored measurement, with the entries added that earlier files do not have."""
    if not isinstance(measurement, dict):
        return measurement
    gaps = measurement.get("gaps")
    if isinstance(gaps, list):
        gaps = [{"either": []} | gap if isinstance(gap, dict) else gap for gap in gaps]
        measurement = measurement | {"gaps": gaps}
    return {"closer": [], "at_most_per_s": None} | measurement
