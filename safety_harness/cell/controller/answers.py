"""Collect the answers of users' controllers, for one episode or for many episodes in parallel lanes.

A lane is one episode's row in arrays that contain all episodes. The process of a user's file uses this module
too, so it imports only modules that need no compiler.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, described, printable
from safety_harness.cell.controller.arrays import Arrays, observed
from safety_harness.seams.contract import IMAGE, MODE, Action, Move, Moves, Report, Seen, Stop, UserController
from safety_harness.seams.rows import SeenLayout, seen_dtype
from safety_harness.trace.records import Mode

Floats = NDArray[np.float64]
NOT_REPORTED = -1  # no value of Mode, all of which are at least 0


class LaneAnswers:
    """The actions of n controllers until the next tick.

    The actions are stored in arrays, which are arguments of the function ``obey``.

    If ``stop`` (n,) is True, the action is a stop. If ``by_joints`` (n,) is True, the action consists of the
    joint velocities in ``joints`` (n, j). Otherwise the action is the twist of the TCP in ``twists`` (n, 6).
    ``modes`` (n,) contains the modes that the controllers report, or NOT_REPORTED.
    """

    def __init__(self, lanes: int, joints: int, reports: tuple[str, ...]) -> None:
        self.twists, self.joints = np.zeros((lanes, 6)), np.zeros((lanes, joints))
        self.by_joints, self.stop = np.zeros(lanes, np.bool_), np.zeros(lanes, np.bool_)
        self.modes = np.full(lanes, NOT_REPORTED, np.int64)
        self._tells = MODE in reports

    @property
    def columns(self) -> tuple[NDArray[Any], ...]:
        """All arrays of the answers, in a fixed order."""
        return self.twists, self.joints, self.by_joints, self.stop, self.modes

    def take(self, lane: int, action: object) -> Action:
        """Store the ``action`` of the lane ``lane``, and return the action.

        Raise ``ControllerError`` if the action is invalid.
        """
        if self._tells:
            reported = getattr(action, "report", None)
            if not isinstance(reported, Report) or not isinstance(reported.mode, Mode):
                raise ControllerError('act reported no Mode, though "mode" is among its reports')
            self.modes[lane] = reported.mode
        if not isinstance(action, Move | Stop):
            raise ControllerError(f"act returned no Move and no Stop: {printable(repr(action))}")
        twist = self.twists[lane]
        self.by_joints[lane] = False
        self.stop[lane] = isinstance(action, Stop)
        if isinstance(action, Stop):
            twist[:] = 0.0
            return action
        linear, angular = action.tcp_velocity_mps, action.tcp_angular_velocity_radps
        if action.joint_velocity_radps is not None:
            if linear is not None or angular is not None:
                raise ControllerError("act returned a Move of both the TCP and the joints")
            joints, name = self.joints[lane], "joint_velocity_radps"
            joints[:] = numbers(name, action.joint_velocity_radps, joints.shape)
            self.by_joints[lane] = True
            return action
        twist[:3] = 0.0 if linear is None else numbers("tcp_velocity_mps", linear, (3,))
        twist[3:] = 0.0 if angular is None else numbers("tcp_angular_velocity_radps", angular, (3,))
        return action

    def take_many(self, lanes: Sequence[int], moves: object) -> None:
        """Store the result ``moves`` of ``act_many`` for all ``lanes``.

        The method makes the same checks as ``take``.
        """
        if not isinstance(moves, Moves):
            raise ControllerError(f"act_many returned no Moves: {printable(repr(moves))}")
        n, own, width_of_joints = len(lanes), np.array(lanes), self.joints.shape[1]
        linear, angular, joints = (
            None if value is None else numbers(name, value, (n, width), "act_many")
            for name, value, width in (
                ("tcp_velocity_mps", moves.tcp_velocity_mps, 3),
                ("tcp_angular_velocity_radps", moves.tcp_angular_velocity_radps, 3),
                ("joint_velocity_radps", moves.joint_velocity_radps, width_of_joints),
            )
        )
        if joints is not None and (linear is not None or angular is not None):
            raise ControllerError("act_many returned Moves of both the TCP and the joints")
        stop = _flags("stop", moves.stop, n)
        if self._tells:
            modes = np.asarray(moves.mode)
            if modes.shape != (n,) or not _are_modes(modes):
                raise ControllerError(
                    f'act_many reported no Mode of each: {n} of them, "mode" being reported'
                )
            self.modes[own] = modes
        going = ~stop
        self.by_joints[own] = going if joints is not None else False
        self.stop[own] = stop
        self.twists[own, :3] = 0.0 if linear is None else np.where(going[:, None], linear, 0.0)
        self.twists[own, 3:] = 0.0 if angular is None else np.where(going[:, None], angular, 0.0)
        if joints is not None:
            self.joints[own] = joints

    def take_sent(self, lanes: Sequence[int], sent: Sequence[bytes]) -> None:
        """Store the actions of ``lanes`` from another process.

        Raise ``ValueError`` if the bytes are invalid.
        """
        if len(sent) != len(self.columns):
            raise ValueError(f"{len(sent)} columns in place of {len(self.columns)}")
        own = np.array(lanes)
        for column, data in zip(self.columns, sent, strict=True):
            rows = np.frombuffer(data, np.uint8 if column.dtype == np.bool_ else column.dtype)
            column[own] = rows.reshape(len(lanes), *column.shape[1:])
        modes = self.modes[own]
        if not (_are_modes(modes) if self._tells else (modes == NOT_REPORTED).all()):
            raise ValueError("an unknown mode")


def numbers(name: str, value: object, shape: tuple[int, ...], call: str = "act") -> NDArray[Any]:
    """Return ``value`` as an array of real numbers with the shape ``shape``.

    Raise ``ControllerError`` if this is impossible. The error states the value's name ``name`` and the method
    ``call`` that returned the value.
    """
    try:
        given = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{call} returned a {name} that is no array of numbers: {error}") from error
    if given.dtype.kind not in "fiu" or given.shape != shape:
        got = f"{given.dtype} of the shape {given.shape}"
        raise ControllerError(f"{call} returned a {name} other than real numbers of the shape {shape}: {got}")
    return given


def _are_modes(modes: NDArray[Any]) -> bool:
    """Return whether ``modes`` are valid values of ``Mode``.

    These values are consecutive integers from zero.
    """
    return modes.dtype.kind in "iu" and bool((modes >= 0).all() and (modes < len(Mode)).all())


def _flags(name: str, value: object, count: int) -> NDArray[np.bool_]:
    """Return ``value`` as booleans (count,), or False for each if ``value`` is None.

    Raise ``ControllerError`` if ``value`` has another type or shape.
    """
    if value is None:
        return np.zeros(count, np.bool_)
    given = np.asarray(value)
    if given.dtype != np.bool_ or given.shape != (count,):
        got = f"{given.dtype} of the shape {given.shape}"
        raise ControllerError(f"act_many returned a {name} other than {count} truths: {got}")
    return given


def answers_many(controller: object) -> bool:
    """Return whether the class of ``controller`` has a method ``act_many``."""
    return callable(getattr(type(controller), "act_many", None))


def ask_together(
    controllers: Sequence[UserController],
    lanes: Sequence[int],
    rows: Floats,
    period_s: float,
    layout: SeenLayout,
    answers: LaneAnswers,
    file: str | None = None,
) -> dict[int, str]:
    """Call the controllers, and return the reason of failure for each lane that cannot continue.

    If ``act_many`` raises an exception or returns a wrong result, the error applies to all lanes.

    Args:
        controllers: The controllers (n,).
        lanes: The rows in ``answers`` that belong to these controllers.
        rows: The views of these controllers (n, wanted), read-only.
        period_s: The control period.
        layout: The layout of a row.
        answers: The answers to fill.
        file: The user's file, for the text of errors.

    """
    kind: Any = type(controllers[0])
    if answers_many(controllers[0]):
        answers.take_many(lanes, kind.act_many(controllers, columns_of(rows, period_s, layout)))
        return {}
    why: dict[int, str] = {}
    for controller, lane, row in zip(controllers, lanes, rows, strict=True):
        try:
            answers.take(lane, controller.act(Seen.of_row(row.item(0), period_s, layout, row)))
        except ControllerError as error:
            why[lane] = in_act(error)
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            why[lane] = f"act raised: {described(error, file) if file else described(error)}"
    return why


def in_act(error: ControllerError) -> str:
    """Return the text of an error, so that it begins with the name of the method ``act``."""
    text = str(error)
    return text if text.startswith("act") else f"act raised: {text}"


def columns_of(rows: Floats, period_s: float, layout: SeenLayout) -> Arrays:
    """Return the quantities in ``rows`` (n, wanted) by name, in the form that ``act_many`` receives."""
    dtype = seen_dtype(layout.hand_slots, layout.joints)
    whole = np.zeros((len(rows), dtype.itemsize // 8))
    whole[:, : rows.shape[1]] = rows
    seen: Arrays = {"time_s": rows[:, 0].copy(), "period_s": np.float64(period_s)}  # type: ignore[dict-item]
    return seen | observed(whole.view(dtype)[:, 0], [sight for sight in layout.sees if sight != IMAGE])


def lanes_of(live: Iterable[bool]) -> list[int]:
    """Return the numbers of the lanes whose entry in ``live`` is True."""
    return [lane for lane, goes in enumerate(live) if goes]
