"""A controller that sees images gets the pixels of the rendered camera, late and faulty as it is."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic, run_trial
from safety_harness.base.exceptions import ControllerError, InadmissibleError
from safety_harness.base.settings import DEFAULTS, ImageSource
from safety_harness.cell.simulation.cell import rendered_object
from safety_harness.scenario.faults import CameraBlind, CameraFrozen, Fault
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.seams.contract import Image, Move, Seen
from safety_harness.trace.compare import first_difference
from safety_harness.trace.trace import Trace

RATE_HZ, LATENCY_S = 25.0, 0.02
CAMERA = replace(
    DEFAULTS.camera,
    source=ImageSource.RENDERED,
    rate_hz=RATE_HZ,
    latency_s=LATENCY_S,
    width_px=160,
    height_px=120,
    focal_px=DEFAULTS.camera.focal_px / 4.0,
)


@dataclass
class Looks:
    """Notes down what it sees, and moves by the brightness of it."""

    name: str = "looks"
    sees: tuple[str, ...] = ("image", "object")
    images: list[Image] = field(default_factory=list)
    visible: list[bool] = field(default_factory=list)

    def reset(self, **_: Any) -> None:
        self.images, self.visible = [], []

    def act(self, seen: Seen) -> Move:
        self.images.append(seen.image)
        self.visible.append(seen.object.visible)
        speed = np.full(6, 1e-3 * float(seen.image.pixels.mean()))
        return Move(joint_velocity_radps=speed)


def cell(*faults: Fault, camera: Any = CAMERA) -> Scenario:
    base = scenario(offset=(0.0, -0.03, 0.09), duration_s=0.4)
    settings = replace(base.settings, camera=camera)
    return replace(base, settings=settings, avoider=NO_AVOIDER, faults=faults)


@cache
def seen_in(*faults: Fault) -> tuple[Looks, Trace]:
    looks = Looks()
    return looks, run_trial(admit(cell(*faults), controller=looks))


def test_pixels_are_those_whose_object_is_seen_and_come_with_rate_and_delay() -> None:
    looks, trace = seen_in()
    assert len(looks.images) == len(trace.ticks)
    assert np.isnan(looks.images[0].time_s)
    assert not looks.images[0].pixels.any()
    for time_s, image, visible in zip(trace.time_s, looks.images, looks.visible, strict=True):
        assert (image.pixels.shape, image.pixels.dtype) == ((120, 160, 3), np.uint8)
        assert not image.pixels.flags.writeable
        assert rendered_object(image.pixels, CAMERA.focal_px)[0] == visible
        if image.new:
            assert time_s >= image.time_s + LATENCY_S - 1e-9
    arrived = [image.time_s for image in looks.images if image.new]
    assert len(arrived) == 10
    assert np.diff(arrived) == pytest.approx(1.0 / RATE_HZ, abs=0.008)
    assert len({image.pixels.tobytes() for image in looks.images}) == 11  # all others, for the arm moves


@pytest.mark.parametrize(
    ("fault", "as_it_is"),
    [
        (CameraBlind(from_s=0.2), lambda before, image: not image.pixels.any()),
        (CameraFrozen(from_s=0.2), lambda before, image: np.array_equal(before.pixels, image.pixels)),
    ],
    ids=["blind", "frozen"],
)
def test_a_fault_of_the_camera_is_one_of_its_pixels(
    fault: Fault, as_it_is: Callable[[Image, Image], bool]
) -> None:
    looks, trace = seen_in(fault)
    before = next(one for one in reversed(looks.images) if one.time_s < 0.2 - 1e-9)
    after = [one for one in looks.images if one.time_s >= 0.2 - 1e-9]
    assert len({one.time_s for one in after}) >= 4
    assert before.pixels.any()
    assert all(as_it_is(before, image) for image in after)
    assert trace.ticks["faults"].any()


FILE = """
import numpy as np
from safety_harness import Move

class Looks:
    name = "looks"
    sees = ("image", "object")
    def reset(self, **_):
        pass
    def act(self, seen):
        return Move(joint_velocity_radps=np.full(6, 1e-3 * float(seen.image.pixels.mean())))
"""

PROGRAM = """
import base64, json, sys
import numpy as np

mean = 0.0
for line in sys.stdin:
    told = json.loads(line)
    if told["say"] == "hello":
        said = {"say": "hello", "protocol": told["protocol"], "name": "looks", "sees": ["image", "object"]}
    elif told["say"] == "reset":
        mean, said = 0.0, {"say": "ready"}
    else:
        if told["seen"]["image"]["pixels"] is not None:
            mean = float(np.frombuffer(base64.b64decode(told["seen"]["image"]["pixels"]), np.uint8).mean())
        said = {"say": "move", "tick": told["tick"], "joint_velocity_radps": [1e-3 * mean] * 6}
    print(json.dumps(said), flush=True)
"""


def test_in_a_process_of_its_own_it_sees_the_same(tmp_path: Path) -> None:
    (tmp_path / "looks.py").write_text(FILE)
    file = tmp_path / "one.yaml"
    own = replace(cell(), controller="looks.py:Looks", file=file)
    assert first_difference(run_trial(admit(own)), seen_in()[1]) is None


def test_a_program_is_told_the_pixels_of_a_new_one_alone(tmp_path: Path) -> None:
    (tmp_path / "looks.py").write_text(PROGRAM)
    trace = run_trial(admit(replace(cell(), controller=f"exec:{sys.executable} {tmp_path / 'looks.py'}")))
    assert first_difference(trace, seen_in()[1]) is None


def test_an_onnx_policy_takes_them(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper, kinds = onnx.helper, onnx.TensorProto
    graph = helper.make_graph(
        [
            helper.make_node("Cast", ["image"], ["pixels"], to=kinds.DOUBLE),
            helper.make_node("ReduceMean", ["pixels"], ["mean"], keepdims=0),
            helper.make_node("Mul", ["mean", "small"], ["speed"]),
            helper.make_node("Expand", ["speed", "shape"], ["joint_velocity_radps"]),
        ],
        "by brightness",
        [helper.make_tensor_value_info("image", kinds.UINT8, (1, "height", "width", 3))],
        [helper.make_tensor_value_info("joint_velocity_radps", kinds.DOUBLE, (1, 6))],
        [
            helper.make_tensor("small", kinds.DOUBLE, [], [1e-3]),
            helper.make_tensor("shape", kinds.INT64, [2], [1, 6]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    (tmp_path / "policy.onnx").write_bytes(model.SerializeToString())
    trace = run_trial(admit(replace(cell(), controller=str(tmp_path / "policy.onnx"))))
    told, other = (one.ticks["demanded_joint_velocity_radps"] for one in (trace, seen_in()[1]))
    assert told.any()
    assert told == pytest.approx(other, rel=1e-6)


def test_where_nothing_is_rendered_it_is_refused() -> None:
    exact = cell(camera=DEFAULTS.camera)
    with pytest.raises(InadmissibleError, match=r"rendered images.*got +exact"):
        admit(exact, controller=Looks())


def test_the_world_without_a_renderer_refuses_it() -> None:
    with pytest.raises(InadmissibleError, match="no renderer"):
        run_kinematic(admit(cell(), controller=Looks()))


def test_who_does_not_say_that_it_sees_them_gets_none() -> None:
    with pytest.raises(ControllerError, match='"image" is not among'):
        run_trial(admit(cell(), controller=Looks(sees=("object",))))
