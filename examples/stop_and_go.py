"""A whole controller: towards the desired TCP by the encoders alone, and a stop while a hand is near.

safety-harness run scenarios/hand-visits-and-leaves.yaml --controller examples/stop_and_go.py:StopAndGo
"""

import numpy as np

from safety_harness import Move, Stop


class StopAndGo:
    """It sees the encoders and the hands as measured, and nothing else."""

    name = "stop and go"
    sees = ("joints", "hands")

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode."""
        self.target_in_base_m = np.array(settings.cell.desired_tcp_position_in_base_m)

    def act(self, seen):
        """What to do until the next tick."""
        tcp_in_base_m = seen.tcp_position_in_base_m
        if any(np.linalg.norm(hand.position_in_base_m - tcp_in_base_m) < 0.3 for hand in seen.hands):
            return Stop()
        return Move(tcp_velocity_mps=0.5 * (self.target_in_base_m - tcp_in_base_m))
