"""Two controllers that ask for too much: one presses on the table, one stops from full speed.

safety-harness run examples/physics/pressing.yaml
safety-harness run examples/physics/full-stop.yaml
"""

import numpy as np

from safety_harness import Move, Stop


class PressDown:
    """Move the TCP straight down, whatever is below."""

    name = "press down"
    sees = ()

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode; nothing is kept."""

    def act(self, seen):
        """Return the same motion at each tick."""
        return Move(tcp_velocity_mps=np.array([0.0, 0.0, -0.1]))


class SwingAndStop:
    """Turn the arm about its foot, faster and faster up to full speed, and stop when a hand is near."""

    name = "swing and stop"
    sees = ("joints", "hands")
    full_speed_radps = 2.0
    speeding_up_radps2 = 4.0  # gentle: no motor saturates before the stop
    stop_within_m = 0.32

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode."""
        self.about_foot = np.eye(len(arm.joint_names))[0]

    def act(self, seen):
        """Return the swing at its present speed, or a protective stop."""
        tcp_in_base_m = seen.tcp_position_in_base_m
        distances_m = [np.linalg.norm(hand.position_in_base_m - tcp_in_base_m) for hand in seen.hands]
        if min(distances_m, default=np.inf) < self.stop_within_m:
            return Stop()
        speed_radps = min(self.full_speed_radps, self.speeding_up_radps2 * (seen.time_s + seen.period_s))
        return Move(joint_velocity_radps=speed_radps * self.about_foot)
