"""The names that are used to write formulas in Python."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.base.renamed import renamed_parameters
from safety_harness.claims.formulas.formula import (
    Always,
    Eventually,
    Formula,
    Globally,
    Initially,
    formula_of,
)
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.formulas.quantities import Quantity, Window, quantity, span_of
from safety_harness.claims.formulas.signals import (
    angle_to_desired_pose,
    deciding,
    distance_to_desired_pose,
    elapsed_time,
    falling_back,
    fault_acting,
    hand_distance,
    hand_tracked,
    image_error,
    joint_speed,
    nearest_hand_to_tcp,
    object_lost,
    object_visible,
    predicted_hand_distance,
    prediction_error,
    repulsing,
    servoing,
    spread,
    stopped,
    tcp_height,
    tcp_speed,
)
from safety_harness.claims.signals.signal import Signal
from safety_harness.scenario.units import ANGLE, ANGULAR_SPEED, LENGTH, SPEED, TIME

__all__ = [
    "Formula",
    "Quantity",
    "Signal",
    "always",
    "angle_to_desired_pose",
    "cm",
    "cm_per_s",
    "deciding",
    "deg",
    "deg_per_s",
    "distance_to_desired_pose",
    "elapsed_time",
    "eventually",
    "falling_back",
    "fault_acting",
    "hand_distance",
    "hand_tracked",
    "image_error",
    "initially",
    "joint_speed",
    "m",
    "m_per_s",
    "minutes",
    "mm",
    "mm_per_s",
    "ms",
    "nearest_hand_to_tcp",
    "object_lost",
    "object_visible",
    "parse_formula",
    "predicted_hand_distance",
    "prediction_error",
    "rad",
    "rad_per_s",
    "repulsing",
    "s",
    "servoing",
    "spread",
    "stopped",
    "tcp_height",
    "tcp_speed",
    "whenever",
]


def mm(number: float) -> Quantity:
    """Millimetres."""
    return quantity(number, "mm", LENGTH)


def cm(number: float) -> Quantity:
    """Centimetres."""
    return quantity(number, "cm", LENGTH)


def m(number: float) -> Quantity:
    """Metres."""
    return quantity(number, "m", LENGTH)


def deg(number: float) -> Quantity:
    """Degrees."""
    return quantity(number, "deg", ANGLE)


def rad(number: float) -> Quantity:
    """Radians."""
    return quantity(number, "rad", ANGLE)


def s(number: float) -> Quantity:
    """Seconds."""
    return quantity(number, "s", TIME)


def ms(number: float) -> Quantity:
    """Milliseconds."""
    return quantity(number, "ms", TIME)


def minutes(number: float) -> Quantity:
    """Minutes."""
    return quantity(number, "min", TIME)


def mm_per_s(number: float) -> Quantity:
    """Millimetres a second."""
    return quantity(number, "mm/s", SPEED)


def cm_per_s(number: float) -> Quantity:
    """Centimetres a second."""
    return quantity(number, "cm/s", SPEED)


def m_per_s(number: float) -> Quantity:
    """Metres a second."""
    return quantity(number, "m/s", SPEED)


def deg_per_s(number: float) -> Quantity:
    """Degrees a second."""
    return quantity(number, "deg/s", ANGULAR_SPEED)


def rad_per_s(number: float) -> Quantity:
    """Radians a second."""
    return quantity(number, "rad/s", ANGULAR_SPEED)


@renamed_parameters(within="window")  # deprecated: the old name, for one release
def always(formula: Formula, *, window: Window = None) -> Formula:
    """Return a formula that requires ``formula`` at every tick from now on, or at every tick of ``window``.

    ``window=s(2)`` lasts from now to 2 s, and ``window=(s(0.1), s(0.5))`` lasts from 0.1 s to 0.5 s. Windows
    include their ends.
    """
    return Always(formula_of(formula, "always"), span_of(window))


@renamed_parameters(within="window")  # deprecated: the old name, for one release
def eventually(formula: Formula, *, window: Window = None) -> Formula:
    """Return a formula that requires ``formula`` at one or more ticks, from now on or within ``window``."""
    return Eventually(formula_of(formula, "eventually"), span_of(window))


def initially(formula: Formula) -> Formula:
    """Return a formula that requires ``formula`` at the first tick of the run."""
    return Initially(formula_of(formula, "initially"))


@dataclass(frozen=True)
class Antecedent:
    """The trigger of ``whenever(...).then(...)``, without its response."""

    trigger: Formula

    def then(self, response: Formula) -> Formula:
        """Return a formula that requires ``response`` at every tick at which the trigger holds."""
        return Globally(self.trigger, formula_of(response, "then"))


def whenever(trigger: Formula) -> Antecedent:
    """Begin ``whenever(p).then(q)``, which requires q at every tick at which the ``trigger`` p holds.

    A run in which p never holds is not evidence.
    """
    return Antecedent(formula_of(trigger, "whenever"))
