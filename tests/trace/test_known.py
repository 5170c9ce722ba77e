"""What is known of a trace survives the disk, nothing impossible is known, and whole traces cost nothing."""

from __future__ import annotations

import copy
import hashlib
import json
import pickle
import zipfile
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import Place, TraceError
from safety_harness.trace.compare import first_difference
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    WHOLLY_KNOWN,
    Gap,
    Knowledge,
    Measurement,
    Source,
)
from safety_harness.trace.records import TICK
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing, until

EVERY_KIND = {
    "hand_position_in_base_m": Measurement(
        source=Source.SENSOR,
        uncertainty=0.008,
        gaps=(Gap(first=3, after=9, hand=0), Gap(first=5, after=7)),
    ),
    "hand_present": Measurement(source=Source.SENSOR, gaps=(Gap(first=0, after=51, hand=1),)),
    "tcp_speed_mps": Measurement(source=Source.DERIVED, uncertainty=1e-3),
    "mode": Measurement(source=Source.LOG, gaps=(Gap(first=0, after=1),)),
    "joint_position_rad": Measurement(source=Source.LOG),
    "gain": Measurement(),
    "decision.fault": NOT_MEASURED,
    "decision.proposed_spread_m": NOT_MEASURED,
    "hand_distance_capsule": NOT_MEASURED,
}


@pytest.fixture(scope="module")
def whole() -> Trace:
    return run_kinematic(admit(scenario(VISIT, duration_s=0.4)))


@pytest.fixture(scope="module")
def stored(whole: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("known") / "part.trace"
    save_trace(knowing(whole, EVERY_KIND), path)
    return path


def with_known(stored: Path, out: Path, known: object) -> Path:
    """The file with another ``known.json``, whose hash is right."""
    data = known if isinstance(known, bytes) else json.dumps(known).encode()
    with zipfile.ZipFile(stored) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(parts["trace.json"])
    header["sha256"]["known.json"] = hashlib.sha256(data).hexdigest()
    parts |= {"known.json": data, "trace.json": json.dumps(header).encode()}
    with zipfile.ZipFile(out, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return out


def known_json(stored: Path) -> dict[str, Any]:
    with zipfile.ZipFile(stored) as archive:
        found: dict[str, Any] = json.loads(archive.read("known.json"))
    return found


def test_every_kind_of_knowledge_survives_the_disk(whole: Trace, stored: Path) -> None:
    loaded, part = load_trace(stored), knowing(whole, EVERY_KIND)
    assert loaded.known == part.known == Knowledge(EVERY_KIND)
    assert first_difference(loaded, part) is None
    assert pickle.loads(pickle.dumps(part.known)) == part.known


def test_what_was_not_measured_is_blank_and_nothing_else_is(whole: Trace) -> None:
    part = knowing(whole, EVERY_KIND)
    hands = part.ticks["hand_position_in_base_m"]
    assert np.isnan(hands[3:9, 0]).all()
    assert np.isnan(hands[5:7]).all()
    before = whole.ticks["hand_position_in_base_m"]
    assert np.array_equal(np.delete(hands[:, 0], slice(3, 9), 0), np.delete(before[:, 0], slice(3, 9), 0))
    assert (part.ticks["hand_distance_capsule"] == -1).all()
    for name in {*(TICK.names or ())} - {*EVERY_KIND}:
        assert part.ticks[name].tobytes() == whole.ticks[name].tobytes()


@pytest.mark.parametrize(
    "columns", [{}, {"mode": Measurement()}], ids=["nothing said", "said to be simulated"]
)
def test_a_wholly_known_trace_is_stored_as_ever(
    columns: dict[str, Measurement], whole: Trace, tmp_path: Path
) -> None:
    save_trace(whole, tmp_path / "a.trace")
    save_trace(knowing(whole, columns), tmp_path / "b.trace")
    assert (tmp_path / "a.trace").read_bytes() == (tmp_path / "b.trace").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.trace") as archive:
        assert "known.json" not in archive.namelist()
        assert json.loads(archive.read("trace.json"))["format"] == "safety-harness trace 4"
    assert load_trace(tmp_path / "a.trace").known == WHOLLY_KNOWN


def test_what_was_logged_without_gaps_is_known_whole_but_was_not_simulated(
    whole: Trace, tmp_path: Path
) -> None:
    logged = knowing(whole, {name: Measurement(source=Source.LOG) for name in COLUMNS_OF_A_TRACE})
    assert (logged.known.whole, logged.known.simulated) == (True, False)
    save_trace(logged, tmp_path / "log.trace")
    assert load_trace(tmp_path / "log.trace").known == logged.known


IMPOSSIBLE = [
    ("no_such_column", NOT_MEASURED),
    ("time_s", NOT_MEASURED),
    ("decision.no_such", NOT_MEASURED),
    ("sse", Measurement(uncertainty=nan)),
    ("sse", Measurement(uncertainty=inf)),
    ("sse", Measurement(uncertainty=-1e-3)),
    ("mode", Measurement(uncertainty=1.0)),
    ("sse", Measurement(gaps=(Gap(first=4, after=4),))),
    ("sse", Measurement(gaps=(Gap(first=-1, after=4),))),
    ("sse", Measurement(gaps=(Gap(first=1, after=4, hand=0),))),
    ("hand_present", Measurement(gaps=(Gap(first=1, after=4, hand=2),))),
    ("hand_distance_m", Measurement(gaps=(Gap(first=1, after=4, hand=1),))),  # there is one
    ("hand_present", Measurement(gaps=(Gap(first=1, after=4, hand=-1),))),
    ("decision.seed", Measurement(gaps=(Gap(first=1, after=4),))),
    ("sse", Measurement(gaps=(Gap(first=1, after=52),))),
]


@pytest.mark.parametrize(("name", "one"), IMPOSSIBLE)
def test_what_nobody_can_know_is_refused_by_its_name(name: str, one: Measurement, whole: Trace) -> None:
    with pytest.raises(TraceError) as caught:
        knowing(whole, {name: one})
    assert caught.value.place.field == f"known.{name}"


@pytest.mark.parametrize(("name", "one"), [case for case in IMPOSSIBLE if np.isfinite(case[1].uncertainty)])
def test_it_is_refused_in_a_file_too_which_is_named(
    name: str, one: Measurement, stored: Path, tmp_path: Path
) -> None:
    gaps = [{"first": gap.first, "after": gap.after, "hand": gap.hand} for gap in one.gaps]
    known = {name: {"source": one.source.value, "uncertainty": one.uncertainty, "gaps": gaps}}
    path = with_known(stored, tmp_path / "wrong.trace", known)
    with pytest.raises(TraceError) as caught:
        load_trace(path)
    assert (caught.value.place.file, caught.value.place.field) == (path, f"known.{name}")


@pytest.mark.parametrize("field", ["source", "uncertainty", "gaps"])
def test_a_file_says_all_of_a_column_or_is_refused(field: str, stored: Path, tmp_path: Path) -> None:
    known = known_json(stored)
    del known["mode"][field]
    with pytest.raises(TraceError) as caught:
        load_trace(with_known(stored, tmp_path / "lacks.trace", known))
    assert (caught.value.place.field or "").startswith("known.mode")


JUNK: tuple[Any, ...] = (None, -1, 1e400, 0.5, "x", [], {}, True, "not measured", [{"first": 0}], 10**30)


def mutated(rng: np.random.Generator, known: dict[str, Any]) -> Any:
    """One value, key or item of it replaced, left out or added."""
    known = copy.deepcopy(known)
    node: Any = known
    while True:
        key = list(node)[rng.integers(len(node))] if isinstance(node, dict) else int(rng.integers(len(node)))
        if isinstance(node, list) or (
            isinstance(node[key], dict | list) and node[key] and rng.uniform() < 0.7
        ):
            node = node[key]
            continue
        match rng.integers(3):
            case 0:
                node[key] = JUNK[rng.integers(len(JUNK))]
            case 1:
                del node[key]
            case _:
                node["odd"] = 1
        return known


def refusal(path: Path) -> Place | None:
    """What a TraceError names; None if the file can be read."""
    try:
        load_trace(path)
    except TraceError as error:
        return error.place
    return None


def test_no_mutation_of_what_is_known_does_worse_than_a_refusal(stored: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(20261123)
    known, refused = known_json(stored), 0
    data = json.dumps(known).encode()
    for number in range(200):
        changed: Any = mutated(rng, known)
        if number % 4 == 0:
            at = int(rng.integers(len(data)))
            changed = data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :]
        path = with_known(stored, tmp_path / "mutated.trace", changed)
        error = refusal(path)
        if error is not None:
            refused += 1
            known_or_blank = ("known.", "hand_distance_capsule ")  # which stand for hands that are there
            assert error.file == path
            assert (error.field or "").startswith(known_or_blank), (error, changed)
    assert refused > 100


def test_a_file_of_a_part_without_its_knowledge_is_none(stored: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(stored) as archive:
        parts = {name: archive.read(name) for name in archive.namelist() if name != "known.json"}
    header = json.loads(parts["trace.json"])
    del header["sha256"]["known.json"]
    parts["trace.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(tmp_path / "less.trace", "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    with pytest.raises(TraceError, match=r"known\.json"):
        load_trace(tmp_path / "less.trace")


def test_of_a_run_that_ends_in_a_gap_the_gap_ends_with_it(whole: Trace) -> None:
    part = knowing(whole, {"sse": Measurement(gaps=(Gap(first=10, after=30), Gap(first=40, after=51)))})
    assert until(part, 20, "cut").known.column("sse").gaps == (Gap(first=10, after=20),)
    assert until(part, 10, "cut").known.whole
    with pytest.raises(TraceError, match=r"known\.sse"):
        replace(part, ticks=part.ticks[:45])


def test_whether_all_is_known_is_asked_for_once(whole: Trace) -> None:
    known = knowing(whole, EVERY_KIND).known
    assert not known.whole
    assert "whole" in vars(known)


def test_what_a_file_knows_counts_whatever_format_it_says_to_have(stored: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(stored) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts["trace.json"] = parts["trace.json"].replace(b"trace 5", b"trace 4")
    with zipfile.ZipFile(tmp_path / "four.trace", "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    assert load_trace(tmp_path / "four.trace").known == load_trace(stored).known
