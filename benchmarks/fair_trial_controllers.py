"""Eight faulty controllers, each one change of ``Sound``, which stops while a hand is near.

Try one: ``safety-harness run SCENARIO --controller benchmarks/fair_trial_controllers.py:Drifts --against
benchmarks/fair_trial_controllers.py:Sound``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from safety_harness import Move, Stop


class Sound:
    """Straight to the desired TCP, and a stop while a hand is nearer than 400 mm."""

    name = "sound"
    sees = ("joints", "hands")
    near_m, gain = 0.4, 0.5
    off_m: tuple[float, ...] = (0.0, 0.0, 0.0)

    def reset(self, *, settings: Any, arm: Any, start: Any, seed: int) -> None:
        """Begin an episode."""
        self.target = np.array(settings.cell.desired_tcp_position_in_base_m) + self.off_m
        self.seen_near: list[bool] = []

    def hands(self, seen: Any) -> list[Any]:
        """Say which hands count."""
        return [one.position_in_base_m for one in seen.hands]

    def near(self, seen: Any) -> bool:
        """Say whether one of them is near."""
        tcp = seen.tcp_position_in_base_m
        return any(float(np.linalg.norm(one - tcp)) < self.near_m for one in self.hands(seen))

    def way(self, seen: Any) -> Any:
        """Give the velocity towards the target."""
        return self.gain * (self.target - seen.tcp_position_in_base_m)

    def act(self, seen: Any) -> Any:
        """Stop or go on."""
        return Stop() if self.near(seen) else Move(tcp_velocity_mps=self.way(seen))


class IgnoresASecondHand(Sound):
    """Looks at the first hand of the list only."""

    name = "ignores a second hand"

    def hands(self, seen: Any) -> list[Any]:
        """Give the first."""
        return super().hands(seen)[:1]


class Drifts(Sound):
    """Goes aside at 4 mm/s once it has arrived."""

    name = "drifts"

    def act(self, seen: Any) -> Any:
        """Go aside, farther and farther."""
        self.target = self.target + np.array([0.0, 0.004 * seen.period_s, 0.0])
        return super().act(seen)


class StopsLate(Sound):
    """Stops 200 ms late."""

    name = "stops 200 ms late"

    def near(self, seen: Any) -> bool:
        """Say what was 25 ticks ago."""
        self.seen_near.append(super().near(seen))
        return self.seen_near[-26] if len(self.seen_near) > 25 else False


class StopsTooNear(Sound):
    """Lets hands come to 120 mm."""

    name, near_m = "stops too near", 0.12


class GoesToTheHand(Sound):
    """Goes towards a hand that is near: a flipped sign."""

    name = "goes to the hand"

    def act(self, seen: Any) -> Any:
        """Go the wrong way."""
        if not self.near(seen):
            return super().act(seen)
        tcp = seen.tcp_position_in_base_m
        hand = min(self.hands(seen), key=lambda one: float(np.linalg.norm(one - tcp)))
        return Move(tcp_velocity_mps=0.2 * (hand - tcp) / max(float(np.linalg.norm(hand - tcp)), 1e-6))


class BlindToTheLeft(Sound):
    """Does not see hands to the left of the base's x axis."""

    name = "blind to the left"

    def hands(self, seen: Any) -> list[Any]:
        """Give those to the right."""
        return [one for one in super().hands(seen) if one[1] < 0.0]


class NeverGoesOn(Sound):
    """Stands for ever after its first stop."""

    name = "never goes on"

    def near(self, seen: Any) -> bool:
        """Keep the first yes."""
        self.seen_near = [(bool(self.seen_near) and self.seen_near[0]) or super().near(seen)]
        return self.seen_near[0]


class ArrivesBeside(Sound):
    """Goes to a place 15 mm beside the desired one."""

    name, off_m = "arrives beside", (0.0, 0.015, 0.0)


CONTROLLERS = (
    IgnoresASecondHand,
    Drifts,
    StopsLate,
    StopsTooNear,
    GoesToTheHand,
    BlindToTheLeft,
    NeverGoesOn,
    ArrivesBeside,
)
