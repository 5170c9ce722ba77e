"""Traces that are whole, with hashes that fit, and hostile all the same."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import TraceError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.trace.records import TICK
from safety_harness.trace.store import load_trace
from tests.whole.hostile.formats import SCENARIO, npy, repacked, run_json, trace_bytes

PROVENANCE = json.loads(run_json())["provenance"]


def put(folder: Path, data: bytes) -> Path:
    path = folder / "t.trace"
    path.write_bytes(data)
    return path


def ticks() -> np.ndarray:
    with zipfile.ZipFile(io.BytesIO(trace_bytes())) as archive:
        return np.lib.format.read_array(io.BytesIO(archive.read("ticks.npy")))


def header(shape: str, descr: str | None = None) -> bytes:
    """The beginning of an array file that promises something."""
    descr = descr or repr(np.lib.format.dtype_to_descr(TICK))
    words = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    padded = words + " " * (-(len(words) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded.encode()


HOSTILE = {
    "a name that leaves the folder": {"run_json": run_json(scenario_name="../../etc/passwd")},
    "an absolute name": {"run_json": run_json(scenario_name="/etc/passwd")},
    "no name": {"run_json": run_json(scenario_name="")},
    "a name that is none": {"run_json": run_json(scenario_name={"a": 1})},
    "a name of two lines": {"run_json": run_json(scenario_name="a\nb")},
    "an endless name": {"run_json": run_json(scenario_name="a" * 10_000)},
    "a file with a zero": {"run_json": run_json(scenario_file="a\0b")},
    "a file that is none": {"run_json": run_json(scenario_file=[1])},
    "an end that is no text": {"run_json": run_json(ended=3)},
    "an avoider that is no text": {"run_json": run_json(provenance=PROVENANCE | {"avoider": {"a": 1}})},
    "libraries without versions": {"run_json": run_json(provenance=PROVENANCE | {"libraries": [1]})},
    "a library too much": {"run_json": run_json(provenance=PROVENANCE | {"libraries": [[1, 2, 3]]})},
    "files that are none": {"run_json": run_json(provenance=PROVENANCE | {"files": [["cv2.so"]]})},
    "no libraries": {"run_json": run_json(provenance={"avoider": "x"})},
    "provenance that is none": {"run_json": run_json(provenance=7)},
    "a run that is deep": {"run_json": b"[" * 1_000_000},
    "a run of no numbers": {"run_json": b"NaN"},
    "the other byte order": {"ticks_npy": npy(ticks().astype(TICK.newbyteorder(">")))},
    "records too many": {"ticks_npy": npy(np.concatenate([ticks(), ticks()]))},
    "times that are none": {"ticks_npy": npy(np.zeros_like(ticks()))},
    "an array of arrays": {"ticks_npy": npy(ticks()[None])},
    "a promise of 2^60 records": {"ticks_npy": header(f"({2**60},)")},
    "a promise of -1 records": {"ticks_npy": header("(-1,)")},
    "a promise that overflows": {"ticks_npy": header(f"({2**64},)") + b"\0" * 736},
    "objects": {"ticks_npy": header("(1,)", "'|O'") + b"\0" * 8},
    "a header that is code": {"ticks_npy": header("__import__('os').system('true')")},
    "a deep header": {"ticks_npy": header("(" * 5_000 + ")" * 5_000)},
    "a scenario that is none": {"scenario_yaml": b"- a\n- b\n"},
    "a scenario in another encoding": {"scenario_yaml": SCENARIO.encode("utf-16")},
    "a scenario without an end": {"scenario_yaml": b"scenario: " + b"x" * 5_000_000},
    "hashes that are none": {"trace_json": b'{"format": "safety-harness trace 3", "sha256": {"a": 1}}'},
    "a list of hashes": {"trace_json": b'{"format": "safety-harness trace 3", "sha256": []}'},
}


@pytest.mark.parametrize("changes", HOSTILE.values(), ids=HOSTILE.keys())
def test_it_is_refused_at_its_place(changes: dict[str, bytes], tmp_path: Path) -> None:
    path = put(tmp_path, repacked(trace_bytes(), **changes))
    with pytest.raises(TraceError) as caught:
        load_trace(path)
    assert caught.value.place.file == path
    assert len(str(caught.value)) < 5_000


def test_a_trace_packed_anew_without_a_change_is_read(tmp_path: Path) -> None:
    assert load_trace(put(tmp_path, repacked(trace_bytes()))).complete


def zipped(parts: list[tuple[str, bytes]]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts:
            archive.writestr(name, data)
    return out.getvalue()


def parts() -> list[tuple[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(trace_bytes())) as archive:
        return [(name, archive.read(name)) for name in archive.namelist()]


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    "extra",
    [
        [("run.json", b"{}")],
        [("../../evil", b"x")],
        [("recordings/x.csv", b"time_s\n")],
        [(f"part{k}", b"") for k in range(20)],
    ],
    ids=["a part twice", "a part that leaves the folder", "a recording without a hash", "many parts"],
)
def test_parts_that_do_not_belong_there_are_refused(extra: list[tuple[str, bytes]], tmp_path: Path) -> None:
    with pytest.raises(TraceError):
        load_trace(put(tmp_path, zipped(parts() + extra)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.trace"]


def test_what_a_stranger_wrote_commands_no_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "\x1b]0;owned\x07<b>\x9b31m"
    assert (
        judge_again([put(tmp_path, repacked(trace_bytes(), run_json=run_json(scenario_name=name)))])
        == AS_EXPECTED
    )
    assert (
        judge_again([put(tmp_path, repacked(trace_bytes(), run_json=run_json(ended="\x1b[2J\n")))])
        == BAD_INPUT
    )
    out, err = capsys.readouterr()
    assert "tested in ?]0;owned?<b>?31m: avoider" in out
    assert (out + err).replace("\n", "").isprintable()
