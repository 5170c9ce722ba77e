"""Transform logged positions to the base frame, with transforms from LOG.yaml or a bag's ``/tf``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length, product
from safety_harness.base.exceptions import LogError, near_miss
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import inverse_transform, transform_from
from safety_harness.extensions.field.logs.bags import Message, error, messages, topics_of
from safety_harness.extensions.field.logs.streams import LogSource
from safety_harness.scenario.codec import POINT, ROTATION
from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Scalar
from safety_harness.scenario.units import shown

ToBase = Callable[[str, Message], Callable[[Sequence[float]], Sequence[float]]]
STILL_M, STILL_RAD = 1e-6, 1e-6  # a frame stands still if its transform in /tf changes by no more
BASE = "base"


@dataclass(frozen=True, eq=False)
class Tree:
    """The fixed transforms of a bag.

    ``parents`` maps the name of a frame to the name of its parent frame and to its pose (4, 4) in the parent
    frame.
    """

    source: LogSource
    parents: dict[str, tuple[str, NDArray[np.float64]]]

    def transform(self, frame: str, base: str) -> NDArray[np.float64]:
        """Return the transform (4, 4) from ``frame`` to ``base``; raise LogError if nothing connects them."""
        (root, root_of_frame), (base_root, root_of_base) = self._to_root(frame), self._to_root(base)
        if root != base_root:
            known = sorted({*self.parents, *(parent for parent, _ in self.parents.values())})
            raise LogError(
                place=self.source.place,
                expected=f'a chain of transforms from "{frame}" to "{base}" in {self.source.name}',
                got=f"the frames {shown(', '.join(known))}",
                hint=near_miss(frame if frame not in known else base, known),
            )
        return np.asarray(product(inverse_transform(root_of_base), root_of_frame))

    def _to_root(self, frame: str) -> tuple[str, NDArray[np.float64]]:
        transform, seen = np.eye(4), {frame}
        while frame in self.parents:
            parent, step = self.parents[frame]
            transform = product(step, transform)
            if parent in seen:
                raise LogError(
                    place=self.source.place,
                    expected="frames without a circle",
                    got=f'"{parent}" above itself',
                )
            seen.add(parent)
            frame = parent
        return frame, transform


def read_tree(source: LogSource, frame: str, base: str) -> Tree:
    """Return the transforms in a topic with messages of type ``TFMessage``, and those in ``/tf_static``.

    Both topics are in the same bag. Raise LogError if a frame between ``frame`` and ``base`` moves, because
    the pose of a moving frame is unknown between two messages.
    """
    parents: dict[str, tuple[str, NDArray[np.float64]]] = {}
    moved: dict[str, tuple[Message, LogSource, float, float]] = {}
    for topic in _topics(source):
        for message in messages(topic):
            for item in getattr(message.content, "transforms", ()):
                child, parent = item.child_frame_id.lstrip("/"), item.header.frame_id.lstrip("/")
                pose = _pose(item.transform, topic, message)
                if child not in parents:
                    parents[child] = parent, pose
                    continue
                was, first = parents[child]
                by_m = float(length(pose[:3, 3] - first[:3, 3]))
                chord = float(length(pose[:3, :3] - first[:3, :3]))
                by_rad = 2.0 * np.arcsin(min(chord / 8.0**0.5, 1.0))  # |A - B| = 8^0.5 sin(by_rad / 2)
                if (was != parent or by_m > STILL_M or by_rad > STILL_RAD) and child not in moved:
                    moved[child] = message, topic, by_m, by_rad
    tree = Tree(source, parents)
    for name in (frame, base):
        at = name
        while at in parents:
            if at in moved:
                message, topic, by_m, by_rad = moved[at]
                got = f"one that has moved by {by_m * 1e3:.4g} mm and turned by {np.degrees(by_rad):.4g} deg"
                expected = f'a frame "{at}" that stands still, between "{frame}" and "{base}"'
                hint = "log positions in the base frame, or give the transform"
                raise error(topic, message, expected, got, hint)
            at = parents[at][0]
    return tree


def _topics(source: LogSource) -> list[LogSource]:
    static = replace(source, what="/tf_static", topic="/tf_static", index=None, path="")
    if source.topic == "/tf_static":
        return [source]
    return [topic for topic in (static, source) if topic.topic in topics_of(source)] or [source]


def _pose(transform: object, source: LogSource, message: Message) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a transform with a quaternion."""
    at, turn = transform.translation, transform.rotation  # type: ignore[attr-defined]
    x, y, z, w = float(turn.x), float(turn.y), float(turn.z), float(turn.w)
    norm = x * x + y * y + z * z + w * w
    if not abs(norm - 1.0) < 1e-3:
        raise error(source, message, "a unit quaternion", f"one of length {norm**0.5:.4g}")
    # The division by the norm also corrects a quaternion whose digits were cut off.
    s = 2.0 / norm
    rotation = np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
        ]
    )
    return transform_from(rotation, np.array([float(at.x), float(at.y), float(at.z)]))


def moved_by(transform: NDArray[np.float64]) -> Callable[[Sequence[float]], Sequence[float]]:
    """Return a function that applies ``transform`` (4, 4) to positions."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = transform[:3].tolist()

    def moved(p: Sequence[float]) -> Sequence[float]:
        return (
            a * p[0] + b * p[1] + c * p[2] + x,
            d * p[0] + e * p[1] + f * p[2] + y,
            g * p[0] + h * p[1] + i * p[2] + z,
        )

    return moved


def by_header(
    base: str, source: LogSource, transform_base: NDArray[np.float64], tf: LogSource | None
) -> ToBase:
    """Return the transforms to base from the frames in message headers.

    The frame in each header must be ``base``, or a frame for which ``tf`` contains transforms to ``base``.

    Args:
        base: The name of the base frame in the bag.
        source: The stream of positions.
        transform_base: The transform (4, 4) from the frame ``base`` to the scenario's base frame.
        tf: The stream of transforms, or None if every header must have the frame ``base``.

    """
    known: dict[str, Callable[[Sequence[float]], Sequence[float]]] = {base: moved_by(transform_base)}

    def to_base(frame: str, message: Message) -> Callable[[Sequence[float]], Sequence[float]]:
        frame = frame.lstrip("/")
        if frame not in known:
            if tf is None:
                hint = 'the key "frame": base, {at: ..., turned: ...}, or {tf: run.mcap#/tf}'
                expected = f'positions in the frame "{base}", or a transform to it'
                raise error(source, message, expected, f'the frame "{shown(frame)}"', hint)
            tree = read_tree(tf, frame, base)
            known[frame] = moved_by(product(transform_base, tree.transform(frame, base)))
        return known[frame]

    return to_base


def by_given(transform: NDArray[np.float64], name: str | None, base: str, source: LogSource) -> ToBase:
    """Return a function that gives the same ``transform`` (4, 4) for every message.

    Args:
        transform: The transform (4, 4) from the frame of the positions to the base frame.
        name: The name of the frame of the positions, or None to accept the frame in the first header.
        base: The name of the base frame. If the messages already have this frame, only the identity is
            accepted as the transform.
        source: The stream of positions.

    Raises:
        LogError: A message's header has a frame that differs from ``name``, or from the frame in the message
            before.

    """
    moved, stated = moved_by(transform), name
    moves = not np.array_equal(transform, np.eye(4))

    def to_base(frame: str, message: Message) -> Callable[[Sequence[float]], Sequence[float]]:
        nonlocal stated
        frame = frame.lstrip("/")
        if frame and stated is None:
            if frame == base and moves:
                raise error(source, message, "another frame than the base, as the file has it", f'"{base}"')
            stated = frame
        if frame not in ("", stated):
            expected = f'the frame "{stated}", ' + ("as the file says" if name else "as messages before it")
            hint = (
                "frame: {base: NAME} names the bag's base frame; {tf: run.mcap#/tf} leads there from others"
            )
            raise error(source, message, expected, f'the frame "{shown(frame)}" in its header', hint)
        return moved

    return to_base


def given_transform(frame: Field) -> NDArray[np.float64]:
    """Return the transform from the frame of the positions to the base frame, shape (4, 4).

    LOG.yaml states this transform.
    """
    if isinstance(frame.node, Scalar):
        frame.one_of({BASE: None})
        return np.eye(4)
    given = frame.fields(("at", "turned", "of"))
    turned = given.optional("turned")
    vector = (0.0, 0.0, 0.0) if turned is None else ROTATION.read(turned)
    return transform_from(rotation_from_vector(np.array(vector)), np.array(POINT.read(given.required("at"))))


def frame_name(frame: Field, base: str) -> str | None:
    """Return the name of the stated frame, or None if LOG.yaml states a pose without a name."""
    if isinstance(frame.node, Scalar):
        return base
    name = frame.fields(("at", "turned", "of")).optional("of")
    return None if name is None else name.sentence("the name of the frame in headers")
