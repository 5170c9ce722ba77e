"""Traces on disk: one zip of plain arrays and JSON, loaded without executing anything.

A file holds the scenario's text with exact values, the recordings that it uses, the ticks, the
decisions and the provenance, and a hash over all of that.  No pickle.  The hashes find damage, not
intent: who edits a file can write them anew.  What contradicts itself is refused all the same, and
whether the rest is true is seen by repeating the run.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import InputError, Place, TraceError
from safety_harness.scenario.model import RecordedHand, Scenario
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.records import DECISION, TICK
from safety_harness.trace.trace import Provenance, Trace

FORMAT = "safety-harness trace 3"
LARGEST_BYTES = 4 * 2**30  # unpacked; a trace of an hour is some 0.6 GB


def save_trace(trace: Trace, path: Path, recordings: Mapping[str, bytes] | None = None) -> None:
    """Write ``trace`` to ``path``, whole or not at all.

    ``recordings`` are the bytes of recorded motions by sha256; those that are not given are read
    from the files that the scenario names.
    """
    parts: dict[str, bytes] = {"scenario.yaml": write_scenario(trace.scenario, all_settings=True).encode()}
    arrays = {
        "ticks.npy": trace.ticks,
        "decisions.npy": trace.decisions,
        "latencies.npy": trace.decision_latency_s,
    }
    for name, array in arrays.items():
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, array, allow_pickle=False)
        parts[name] = buffer.getvalue()
    for hand in trace.scenario.hands:
        if isinstance(hand, RecordedHand):
            digest = hand.motion.sha256
            known = (recordings or {}).get(digest)
            parts[f"recordings/{digest}.csv"] = (
                known if known is not None else _recording(trace.scenario, hand)
            )
    run = {
        "scenario_name": trace.scenario.name,
        "scenario_file": str(trace.scenario.file) if trace.scenario.file else None,
        "ended": trace.ended,
        "provenance": asdict(trace.provenance),
    }
    parts["run.json"] = json.dumps(run, indent=1, sort_keys=True).encode()
    header = {
        "format": FORMAT,
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(parts.items())},
    }
    parts["trace.json"] = json.dumps(header, indent=1, sort_keys=True).encode()
    temporary = path.with_name(path.name + ".part")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in sorted(parts):
            archive.writestr(zipfile.ZipInfo(name), parts[name], zipfile.ZIP_DEFLATED)
    os.replace(temporary, path)


def _recording(scenario: Scenario, hand: RecordedHand) -> bytes:
    """The bytes of a recording; TraceError if the file has changed since it was read."""
    folder = scenario.file.parent if scenario.file else Path()
    data = (folder / hand.recording).read_bytes()
    if hashlib.sha256(data).hexdigest() != hand.motion.sha256:
        raise TraceError(
            place=Place(file=folder / hand.recording),
            expected=f"the recording that the scenario was read with (sha256 {hand.motion.sha256[:12]}...)",
            got="a file that has changed since",
        )
    return data


def load_trace(path: Path) -> Trace:
    """Read a trace; TraceError says what is wrong with a file that is none, damaged or contradictory."""
    return _Reader(path).trace()


class _Reader:
    """Reads one file; every failure names it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts = self._unpack()

    def trace(self) -> Trace:
        self._check_hashes()
        run = self._json("run.json", {"scenario_name", "scenario_file", "ended", "provenance"})
        decisions = self._array("decisions.npy", DECISION)
        latencies_s = self._array("latencies.npy", np.dtype(np.float64))
        if len(latencies_s) != len(decisions):
            raise self._error(f"{len(decisions)}, one a decision", str(len(latencies_s)), "latencies.npy")
        trace = Trace(
            scenario=self._scenario(run),
            ticks=self._array("ticks.npy", TICK),
            decisions=decisions,
            decision_latency_s=latencies_s,
            provenance=self._provenance(run),
            ended=str(run["ended"]),
        )
        wrong = first_inconsistency(trace)
        if wrong is not None:
            raise self._error(wrong.expected, wrong.got, wrong.where)
        return trace

    def _error(self, expected: str, got: str, field: str | None = None) -> TraceError:
        return TraceError(place=Place(file=self._path, field=field), expected=expected, got=got)

    def _unpack(self) -> dict[str, bytes]:
        try:
            with zipfile.ZipFile(self._path) as archive:
                size = sum(info.file_size for info in archive.infolist())
                if size > LARGEST_BYTES:
                    raise self._error(f"at most {LARGEST_BYTES} bytes unpacked", f"{size} bytes")
                return {info.filename: archive.read(info) for info in archive.infolist()}
        except FileNotFoundError:
            raise self._error("a trace file", "no such file") from None
        except (
            OSError,
            zipfile.BadZipFile,
            EOFError,
            NotImplementedError,
            RuntimeError,
            ValueError,
        ) as error:
            raise self._error("a trace file, whole", str(error) or type(error).__name__) from error
        except Exception as error:  # zlib.error, struct.error: whatever damaged bytes provoke
            raise self._error("a trace file, whole", f"{type(error).__name__}: {error}") from error

    def _json(self, name: str, keys: set[str]) -> dict[str, Any]:
        """A part that is a JSON object with at least these keys."""
        try:
            found = json.loads(self._parts[name])
        except (KeyError, ValueError, RecursionError) as error:
            raise self._error("a JSON object", f"none that can be read ({error!r})", name) from error
        if not isinstance(found, dict) or not keys <= found.keys():
            raise self._error(f"an object with {', '.join(sorted(keys))}", "something else", name)
        return found

    def _check_hashes(self) -> None:
        header = self._json("trace.json", {"format", "sha256"})
        hashes = header["sha256"]
        if header["format"] != FORMAT or not isinstance(hashes, dict):
            raise self._error(f"the format {FORMAT!r}", repr(header["format"]), "format")
        actual = {
            name: hashlib.sha256(data).hexdigest()
            for name, data in self._parts.items()
            if name != "trace.json"
        }
        for name in sorted(hashes.keys() | actual.keys()):
            if hashes.get(name) != actual.get(name):
                raise self._error(
                    f"contents with sha256 {hashes.get(name)}", f"sha256 {actual.get(name)}", name
                )

    def _scenario(self, run: dict[str, Any]) -> Scenario:
        recordings = {
            name.removeprefix("recordings/").removesuffix(".csv"): data
            for name, data in self._parts.items()
            if name.startswith("recordings/")
        }
        try:
            text = self._parts["scenario.yaml"].decode()
            file = Path(run["scenario_file"] or f"{run['scenario_name']}.yaml")
            return parse_scenario(text, file, recordings, claims_required=False)
        except (KeyError, UnicodeDecodeError, TypeError) as error:
            raise self._error("a scenario in the trace", f"none that can be read ({error!r})") from error
        except InputError as error:
            raise self._error("a scenario that this version reads", str(error), "scenario.yaml") from error

    def _array(self, name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
        try:
            array = np.lib.format.read_array(io.BytesIO(self._parts[name]), allow_pickle=False)
        except (KeyError, ValueError, EOFError, OSError) as error:
            raise self._error("an array of records", f"none that can be read ({error})", name) from error
        if array.dtype != dtype or array.ndim != 1:
            raise self._error("records as this version writes them", f"{array.dtype}", name)
        return array

    def _provenance(self, run: dict[str, Any]) -> Provenance:
        try:
            fields = dict(run["provenance"])
            fields["libraries"] = tuple((str(a), str(b)) for a, b in fields["libraries"])
            return Provenance(**fields)
        except (KeyError, TypeError, ValueError) as error:
            raise self._error("the provenance of the run", repr(error), "provenance") from error
