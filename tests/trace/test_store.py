"""Traces survive the disk bit by bit, and nothing that is no trace passes for one."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import scenario

from safety_harness import admit, judge, read_scenario, run_trial
from safety_harness.base.exceptions import TraceError
from safety_harness.scenario.model import EDITION, Claim, RecordedHand, Verdict
from safety_harness.trace.compare import first_difference
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

FOLDER = Path(__file__).parents[2] / "scenarios"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Trace, Path]:
    claims = (Claim(sentence="joint speeds within limits", expected=Verdict.HOLDS),)
    trace = run_trial(admit(replace(scenario(duration_s=0.4), claims=claims)))
    path = tmp_path_factory.mktemp("traces") / "example.trace"
    save_trace(trace, path)
    return trace, path


def rewritten(path: Path, out: Path, **changes: bytes | None) -> Path:
    """A copy of a trace in which parts are replaced or, with None, left out."""
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(out, "w") as after:
        for name in before.namelist():
            key = name.replace(".", "_")
            data = changes.get(key, before.read(name))
            if data is not None:
                after.writestr(name, data)
    return out


def test_a_trace_loads_as_it_was_saved(stored: tuple[Trace, Path]) -> None:
    trace, path = stored
    loaded = load_trace(path)
    assert first_difference(trace, loaded) is None
    assert replace(loaded.scenario, name=trace.scenario.name) == trace.scenario
    assert loaded.provenance == trace.provenance
    assert loaded.complete
    assert judge(loaded) == judge(trace)
    assert list(path.parent.glob("*.part")) == []


def test_a_trace_of_a_version_that_hashed_no_libraries_is_read(
    stored: tuple[Trace, Path], tmp_path: Path
) -> None:
    trace, path = stored
    with zipfile.ZipFile(path) as archive:
        run, header = json.loads(archive.read("run.json")), json.loads(archive.read("trace.json"))
    del run["provenance"]["files"]
    text = json.dumps(run).encode()
    header["sha256"]["run.json"] = hashlib.sha256(text).hexdigest()
    before = tmp_path / "before.trace"
    rewritten(path, before, run_json=text, trace_json=json.dumps(header).encode())
    assert load_trace(before).provenance == replace(trace.provenance, files=())


def test_saving_twice_gives_the_same_bytes(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    trace, path = stored
    save_trace(trace, tmp_path / "again.trace")
    assert (tmp_path / "again.trace").read_bytes() == path.read_bytes()


def test_what_lies_between_the_fields_of_a_record_is_not_stored(
    stored: tuple[Trace, Path], tmp_path: Path
) -> None:
    trace, path = stored
    other = np.full(trace.ticks.nbytes, 0xAA, np.uint8).view(trace.ticks.dtype)
    for name in trace.ticks.dtype.names:
        other[name] = trace.ticks[name]
    assert other.tobytes() != trace.ticks.tobytes()
    save_trace(replace(trace, ticks=other), tmp_path / "other.trace")
    assert (tmp_path / "other.trace").read_bytes() == path.read_bytes()


def test_a_loaded_trace_is_read_only(stored: tuple[Trace, Path]) -> None:
    loaded = load_trace(stored[1])
    with pytest.raises(ValueError, match="read-only"):
        loaded.ticks["time_s"][0] = 1.0


def test_a_scenario_without_claims_survives_too(tmp_path: Path) -> None:
    trace = run_trial(admit(scenario(duration_s=0.1)))
    save_trace(trace, tmp_path / "bare.trace")
    assert load_trace(tmp_path / "bare.trace").scenario.claims == ()


def test_a_trace_carries_its_recordings(tmp_path: Path) -> None:
    recorded = replace(read_scenario(FOLDER / "recorded-giving.yaml"), duration_s=0.2)
    save_trace(run_trial(admit(recorded)), tmp_path / "r.trace")
    moved = load_trace(tmp_path / "r.trace")  # no recording lies beside it
    hand = moved.scenario.hands[0]
    assert isinstance(hand, RecordedHand)
    assert hand.motion == recorded.hands[0].motion  # type: ignore[union-attr]


def test_a_recording_that_changed_since_is_refused(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    text = (FOLDER / "recorded-giving.yaml").read_text()
    (tmp_path / "s.yaml").write_text(text)
    copy = tmp_path / "recordings" / "humanrobothandover-1.csv"
    copy.write_bytes((FOLDER / "recordings" / copy.name).read_bytes())
    trace = run_trial(admit(replace(read_scenario(tmp_path / "s.yaml"), duration_s=0.05)))
    copy.write_bytes(copy.read_bytes() + b"\n")
    with pytest.raises(TraceError, match="changed since"):
        save_trace(trace, tmp_path / "r.trace")


def test_every_truncation_is_noticed(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    data = stored[1].read_bytes()
    for length in np.linspace(0, len(data) - 1, 25).astype(int):
        cut = tmp_path / "cut.trace"
        cut.write_bytes(data[:length])
        with pytest.raises(TraceError):
            load_trace(cut)


def test_no_bit_flip_passes_for_the_original(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    trace, path = stored
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    flipped = tmp_path / "flipped.trace"
    refused = 0
    for at in rng.integers(0, len(data), 60):
        changed = bytearray(data)
        changed[at] ^= 1 << int(rng.integers(8))
        flipped.write_bytes(bytes(changed))
        try:
            loaded = load_trace(flipped)
        except TraceError:
            refused += 1
            continue
        assert first_difference(trace, loaded) is None  # it hit a byte that means nothing (a date, say)
    assert refused > 40


@pytest.mark.parametrize(
    ("part", "data"),
    [
        ("ticks_npy", None),
        ("scenario_yaml", None),
        ("trace_json", None),
        ("trace_json", b"{}"),
        ("trace_json", b"[1, 2]"),
        ("trace_json", b"not json"),
        ("ticks_npy", b"junk"),
        ("scenario_yaml", b"scenario: changed"),
    ],
)
def test_a_missing_or_changed_part_is_refused(
    part: str, data: bytes | None, stored: tuple[Trace, Path], tmp_path: Path
) -> None:
    with pytest.raises(TraceError) as caught:
        load_trace(rewritten(stored[1], tmp_path / "changed.trace", **{part: data}))
    assert caught.value.place.file == tmp_path / "changed.trace"


def test_an_edited_end_is_noticed(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    with zipfile.ZipFile(stored[1]) as archive:
        run = json.loads(archive.read("run.json"))
    run["ended"] = "interrupted by the user"
    changed = rewritten(stored[1], tmp_path / "e.trace", run_json=json.dumps(run).encode())
    with pytest.raises(TraceError, match=r"run\.json"):
        load_trace(changed)


def test_a_pickle_is_never_loaded(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.array([object()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(stored[1]) as archive:
        header = json.loads(archive.read("trace.json"))
    header["sha256"]["ticks.npy"] = hashlib.sha256(buffer.getvalue()).hexdigest()
    changed = rewritten(
        stored[1],
        tmp_path / "p.trace",
        ticks_npy=buffer.getvalue(),
        trace_json=json.dumps(header).encode(),
    )
    with pytest.raises(TraceError, match=r"ticks\.npy"):
        load_trace(changed)


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"PK\x03\x04" + b"\0" * 40], ids=["empty", "text", "half a zip"]
)
def test_a_file_that_is_no_trace_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.trace"
    path.write_bytes(content)
    with pytest.raises(TraceError):
        load_trace(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.trace", tmp_path):
        with pytest.raises(TraceError):
            load_trace(path)


def test_two_traces_in_one_file_are_refused(stored: tuple[Trace, Path], tmp_path: Path) -> None:
    """Of two, only the last would be read, and the file would pass for the whole of both."""
    both = tmp_path / "both.trace"
    both.write_bytes(stored[1].read_bytes() * 2)
    with pytest.raises(TraceError, match="one trace alone in the file"):
        load_trace(both)


def test_a_trace_that_tells_no_edition_is_judged_by_the_first(
    stored: tuple[Trace, Path], tmp_path: Path
) -> None:
    """A trace made when hands were taken to walk keeps that reading, also when it is stored again."""
    with zipfile.ZipFile(stored[1]) as archive:
        run, header = (json.loads(archive.read(name)) for name in ("run.json", "trace.json"))
    assert run.pop("claims") == EDITION
    text = json.dumps(run).encode()
    header["sha256"]["run.json"] = hashlib.sha256(text).hexdigest()
    file = rewritten(
        stored[1], tmp_path / "then.trace", run_json=text, trace_json=json.dumps(header).encode()
    )
    then = load_trace(file)
    assert {claim.edition for claim in then.scenario.claims} == {1}
    save_trace(then, file)
    assert {claim.edition for claim in load_trace(file).scenario.claims} == {1}
