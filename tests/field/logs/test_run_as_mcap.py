"""A run goes out as MCAP and comes back as a log: no verdict that the log gives contradicts the run's."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from safety_harness import admit, judge, run_trial
from safety_harness.base.exceptions import OutputError, TraceError
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.cell.simulation.worlds import world_named
from safety_harness.claims.properties.base import Unit
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.cli.main import app
from safety_harness.extensions.field import run_as_mcap
from safety_harness.extensions.field.logs.judging import recorded
from safety_harness.extensions.field.run_as_mcap import LOG_FILE, write_mcap
from safety_harness.scenario.expand import read_all_scenarios
from safety_harness.scenario.model import Verdict
from safety_harness.seams.contract import Image
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[3]
SHIPPED = {one.name: one for one in read_all_scenarios(ROOT / "scenarios")}
FAST_S = 2.5
# Until their hands have come near and their verdicts are there; in whole they come back at night.
QUICK_S = {
    "fast-reach": FAST_S,
    "recorded-handover-two-hands": 4.0,
    "robot-panda": 2.5,
    "overhead-camera": 4.3,
}
KINEMATIC = world_named("kinematic", "--world")
SPEEDS = (Unit.SPEED, Unit.ANGULAR_SPEED)


@lru_cache
def trace_of(name: str, duration_s: float) -> Trace:
    return run_trial(admit(replace(SHIPPED[name], duration_s=duration_s)), world=KINEMATIC)


def exported(trace: Trace, folder: Path) -> Path:
    write_mcap(trace, judge(trace), folder / "run.mcap")
    return folder / LOG_FILE


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the files of ``fast-reach``, which most tests here look at."""
    return exported(trace_of("fast-reach", FAST_S), tmp_path_factory.mktemp("fast")).parent


@pytest.fixture(scope="module")
def fast_back(fast: Path) -> Trace:
    return recorded(fast / LOG_FILE).trace


@lru_cache
def contents(folder: Path, topic: str) -> list[tuple[int, Any]]:
    with AnyReader([folder / "run.mcap"]) as bag:
        of_topic = [one for one in bag.connections if one.topic == topic]
        assert of_topic, topic
        found = bag.messages(connections=of_topic)
        return [(at, bag.deserialize(raw, one.msgtype)) for one, at, raw in found]


def _comes_back(trace: Trace, back: Trace) -> None:
    """Equal or inconclusive verdicts; what is certain of a distance or speed is near the run's margin."""
    name = trace.scenario.name
    assert np.array_equal(back.time_s, trace.time_s)
    pairs = list(zip(judge(trace), judge(back), strict=True))
    for run, log in pairs:
        assert log.verdict in (run.verdict, Verdict.INCONCLUSIVE), (name, run, log)
        if run.sentence.startswith("hand distance never below") and log.margin is not None:
            assert run.margin is not None
            off_m = (
                float(back.known.uncertainty_of("hand_distance_m", len(back.ticks))[:-1].max()) + 2.0 * 1e-4
            )
            bent_m = abs(log.margin - run.margin)
            assert bent_m <= 2.0 * off_m, (name, run, log)
        elif run.unit in SPEEDS and log.margin is not None and run.margin is not None:
            assert log.margin <= run.margin + 1e-6 or log.verdict is Verdict.VIOLATED, (name, run, log)


@pytest.mark.parametrize("name", QUICK_S)
def test_a_run_comes_back_without_a_contradiction(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    trace = trace_of(name, QUICK_S[name])
    again = name == "fast-reach"
    back = request.getfixturevalue("fast_back") if again else recorded(exported(trace, tmp_path)).trace
    _comes_back(trace, back)


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_run_comes_back_without_a_contradiction(name: str, tmp_path: Path) -> None:
    trace = trace_of(name, SHIPPED[name].duration_s)
    _comes_back(trace, recorded(exported(trace, tmp_path)).trace)


def test_the_log_has_the_joints_and_hands_of_the_run(fast_back: Trace) -> None:
    trace, back = trace_of("fast-reach", FAST_S), fast_back
    for name in ("joint_position_rad", "hand_position_in_base_m", "elbow_position_in_base_m"):
        assert np.allclose(back.ticks[name][:, :1], trace.ticks[name][:, :1], rtol=0.0, atol=2e-6), name
    assert np.array_equal(back.ticks["mode"], trace.ticks["mode"])
    assert np.array_equal(back.ticks["limits"], trace.ticks["limits"])
    assert np.array_equal(back.decisions["tick"], trace.decisions["tick"])


def test_a_violation_is_certain_in_the_log_too(fast_back: Trace) -> None:
    """The run is 126.5 mm inside the limit, and its hand moves 0.5 ms x 2 m/s at most between two samples."""
    trace = trace_of("fast-reach", FAST_S)
    run, log = judge(trace)[0], judge(fast_back)[0]
    assert log.verdict is Verdict.VIOLATED
    assert run.margin is not None
    assert log.margin == pytest.approx(run.margin, abs=2e-3)
    assert log.worst_time_s == pytest.approx(run.worst_time_s, abs=0.008)


def test_margins_have_their_limits_and_decisions_are_events(fast: Path) -> None:
    trace = trace_of("fast-reach", FAST_S)
    rows = contents(fast, "/claim_1")
    nearest_m = true_motion(trace).nearest_m
    assert [at for at, _ in rows] == [10**9 + round(t * 1e9) for t in trace.time_s]
    assert [one.margin for _, one in rows] == pytest.approx((nearest_m - 0.05).tolist())
    assert {one.limit for _, one in rows} == {0.05}
    ((end_ns, last),) = contents(fast, "/claim_1/verdict")
    assert (last.verdict, last.unit, end_ns) == ("violated", "m", rows[-1][0])
    events = contents(fast, "/events")
    assert [at for at, one in events if one.name == "decision"] == [
        10**9 + round(t * 1e9) for t in trace.decisions["time_s"]
    ]
    assert any(one.name == "claim" and one.level == 4 and "hand distance" in one.message for _, one in events)


def test_the_drawn_arm_and_hands_are_where_they_were(fast: Path) -> None:
    trace = trace_of("fast-reach", FAST_S)
    _, tf = contents(fast, "/tf")[-1]
    (tcp,) = [one for one in tf.transforms if one.child_frame_id == "tcp"]
    at, turn = tcp.transform.translation, tcp.transform.rotation
    pose = trace.ticks["transform_tcp_to_base"][-1]
    assert [at.x, at.y, at.z] == pytest.approx(pose[:3, 3].tolist())
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    axis = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]  # of the tool
    assert axis == pytest.approx(pose[:3, 2].tolist(), abs=1e-9)
    _, scene = contents(fast, "/hands")[100]
    (hand,) = scene.entities
    ball = hand.spheres[0]
    assert hand.id == "right hand"
    assert ball.size.x == pytest.approx(0.12)
    where = trace.ticks["hand_position_in_base_m"][100, 0]
    assert [ball.pose.position.x, ball.pose.position.y, ball.pose.position.z] == pytest.approx(where.tolist())
    ((_, still),) = contents(fast, "/scene")
    frames = {one.frame_id for one in still.entities}
    assert frames <= {"base_link", *(one.child_frame_id for one in tf.transforms)}


def test_the_command_writes_both_files_and_judge_reads_them(tmp_path: Path) -> None:
    save_trace(trace_of("fast-reach", 2.0), tmp_path / "fast.trace")
    out = tmp_path / "out" / "run: 1, [a] {b} #c 'd' \u00e9.mcap"  # which YAML has to quote
    for _ in range(2):  # the second one takes the place of the first
        found = CliRunner().invoke(app, ["export", str(tmp_path / "fast.trace"), "--out", str(out)])
        assert found.exit_code == 0, found.output
    claim = "hand distance never below 50 mm"
    judged = CliRunner().invoke(app, ["judge", str(out.parent / LOG_FILE), "--claim", claim])
    assert judged.exit_code == 1, judged.output
    assert "VIOLATED  hand distance never below 50 mm  -125.7 mm at 1.952 s (expected holds)" in judged.output


def test_the_camera_shows_in_the_file_what_the_controller_saw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rendered again: 2 black images of a blind camera, 2 of the object, and the second of these frozen."""
    text = (ROOT / "scenarios" / "rendered-images.yaml").read_text().replace("4 s", "280 ms")
    faults = "faults: [{camera: sees nothing, until: 100 ms}, {camera: freezes, from: 260 ms}]\n"
    (tmp_path / "seen.yaml").write_text(text.replace("detector: rendered", "detector: exact") + faults)
    seen, observe = list[Image](), PyBulletWorld.observe

    def observed(world: PyBulletWorld) -> Any:
        observation = observe(world)
        if observation[0]["image_new"]:
            seen.append(world.image())
        return observation

    monkeypatch.setattr(PyBulletWorld, "observe", observed)
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, ["run", str(tmp_path / "seen.yaml"), "--out", str(out), "--mcap"])
    assert ran.exit_code == 1, ran.output
    shown = contents(out / "traces" / "seen", "/camera")
    pixels = [np.asarray(cv2.imdecode(one.data, cv2.IMREAD_COLOR))[:, :, ::-1] for _, one in shown]
    assert len(shown) == 5
    seen = seen[: len(shown)]  # the export's own rendering passed by as well
    assert [at for at, _ in shown] == [10**9 + round(image.time_s * 1e9) for image in seen]
    assert all(np.array_equal(one, image.pixels) for one, image in zip(pixels, seen, strict=True))
    assert [bool(one.any()) for one in pixels] == [False, False, True, True, True]
    assert np.array_equal(pixels[4], pixels[3])
    assert not np.array_equal(pixels[3], pixels[2])


def test_a_log_and_a_foreign_description_are_refused(fast: Path, fast_back: Trace) -> None:
    with pytest.raises(TraceError, match="simulated run"):
        write_mcap(fast_back, judge(fast_back), fast / "again.mcap")
    with pytest.raises(OutputError, match="one that an export wrote"):
        write_mcap(trace_of("fast-reach", FAST_S), (), fast / "other.mcap")
    assert not (fast / "other.mcap").exists()


def test_the_layout_shows_topics_and_fields_that_an_export_has(fast: Path) -> None:
    layout = json.loads((ROOT / "examples" / "foxglove-layout.json").read_text())
    with AnyReader([fast / "run.mcap"]) as bag:
        fields = {
            one.topic: [n for n, _ in bag.typestore.fielddefs[one.msgtype][1]] for one in bag.connections
        }
    plots = [p for key, one in layout["configById"].items() if key.startswith("Plot!") for p in one["paths"]]
    assert plots
    for path in plots:
        topic, _, rest = path["value"].partition(".")
        assert rest.partition("[")[0] in fields[topic], path
    for key, one in layout["configById"].items():
        assert set(one.get("topics", {})) <= set(fields), key
        assert one.get("topicToRender", "/events") in fields
        assert one.get("imageMode", {}).get("imageTopic", "/camera") == "/camera"  # of rendered images alone


def test_every_panel_of_the_layout_has_a_place_in_it_and_its_settings() -> None:
    layout = json.loads((ROOT / "examples" / "foxglove-layout.json").read_text())

    def panels(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else [*panels(node["first"]), *panels(node["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_faster_hands_than_said_would_be_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bounds that LOG.yaml states are held against the samples when it is read."""
    from safety_harness.base.exceptions import LogError

    monkeypatch.setattr(run_as_mcap, "_bounds", lambda trace: (3.2, 1e3, 0.1))
    with pytest.raises(LogError, match=r"possible at 0\.1 m/s"):
        recorded(exported(trace_of("fast-reach", 1.0), tmp_path))
