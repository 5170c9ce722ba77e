"""The controller of stop_and_go.py, which answers for many episodes at once, as campaigns ask.

safety-harness run FILE --controller examples/stop_and_go_together.py:StopAndGo
"""

import numpy as np

from safety_harness import Move, Moves, Stop


class StopAndGo:
    """It sees the encoders and the hands as measured, and nothing else."""

    name = "stop and go together"
    sees = ("joints", "hands")

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode."""
        self.target_in_base_m = np.array(settings.cell.desired_tcp_position_in_base_m)

    def act(self, seen):
        """Stop while a hand is within 300 mm of the TCP, else go on."""
        tcp_in_base_m = seen.tcp_position_in_base_m
        if any(distance_m(hand.position_in_base_m - tcp_in_base_m) < 0.3 for hand in seen.hands):
            return Stop()
        return Move(tcp_velocity_mps=0.5 * (self.target_in_base_m - tcp_in_base_m))

    @staticmethod
    def act_many(controllers, seen):
        """As ``act`` of each of n controllers, from what they see, n rows each."""
        tcps_in_base_m = seen["tcp_position_in_base_m"]
        near = distance_m(seen["hands"] - tcps_in_base_m[:, None]) < 0.3
        targets_in_base_m = np.array([one.target_in_base_m for one in controllers])
        return Moves(
            tcp_velocity_mps=0.5 * (targets_in_base_m - tcps_in_base_m),
            stop=np.any(near & (seen["hands_there"] == 1), axis=1),
        )


def distance_m(way):
    """(...,) of (..., 3), in the same order of operations for one and for many."""
    x, y, z = np.moveaxis(way, -1, 0)
    return np.sqrt(x * x + y * y + z * z)
