"""A hand predictor of your own: a parabola through the last positions, and a ball around where it leads.

For each hand it fits a constant acceleration to the positions of the last 200 ms by least squares, and
follows the parabola to the end of the horizon. The radius of the ball does not come from the fit: it is a
quantile of the errors in simulated runs (split conformal prediction; Vovk, Gammerman and Shafer, 2005).
"""

import numpy as np

from safety_harness import HandSet, Predicted

WINDOW_S = 0.2  # of the fit; a hand without a measurement for so long is given up
SAME_HAND_M = 0.25  # a hand moves by less between two frames
HORIZON_S = 0.1
# calibrate_predictor.py prints the radius: the 190th smallest of 199 errors, one from each of 199 runs. A
# further run of the same space is exchangeable with these. Its error at one drawn instant is then at most the
# radius with a probability of at least 190/200 = 95 %. The window was chosen with other runs.
RADIUS_M = 0.13


class ConstantAcceleration:
    """The predictor; it sees the measured hands, and the time of their frame."""

    name = "constant acceleration"
    sees = ("hands", "hand boxes")

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode without any hand."""
        self.horizon_s = settings.hand_filter.prediction_horizon_s
        if self.horizon_s != HORIZON_S:
            raise ValueError(f"the radius is calibrated for {HORIZON_S} s ahead, not {self.horizon_s} s")
        self.tracks, self.count = {}, 0  # for each number, the times and positions of its measurements

    def act(self, seen):
        """Return a ball for each hand at the end of the horizon."""
        frame = seen.hand_boxes
        if frame.new:
            self.measure(frame.time_s, [hand.position_in_base_m for hand in seen.hands])
        self.tracks = {k: one for k, one in self.tracks.items() if frame.time_s - one[-1][0] < WINDOW_S}
        then_s = seen.time_s + self.horizon_s
        return Predicted(
            hands=[
                HandSet(position_in_base_m=followed(one, then_s), number=k, radius_m=RADIUS_M)
                for k, one in self.tracks.items()
            ]
        )

    def measure(self, time_s, positions_m):
        """Add each position to the track whose last one is nearest, or begin a track."""
        free = set(self.tracks)
        for position_m in positions_m:
            away_m = {k: np.linalg.norm(position_m - self.tracks[k][-1][1]) for k in sorted(free)}
            nearest = min(away_m, key=away_m.get, default=None)
            if nearest is None or away_m[nearest] > SAME_HAND_M:
                self.count += 1
                nearest, self.tracks[self.count] = self.count, []
            free.discard(nearest)
            track = self.tracks[nearest]
            track.append((time_s, position_m))
            self.tracks[nearest] = [one for one in track if time_s - one[0] <= WINDOW_S + 1e-9]


def followed(track, then_s):
    """Return the position (3,) at ``then_s`` on a fitted parabola, or on a line if there are few."""
    times_s, positions_m = np.array([one[0] for one in track]), np.array([one[1] for one in track])
    powers = np.vander(times_s - then_s, min(2, (len(track) - 1) // 3) + 1, increasing=True)
    return np.linalg.lstsq(powers, positions_m, rcond=None)[0][0]
