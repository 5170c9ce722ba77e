"""Draw repulsive candidates on a quarter sphere around the TCP (section 4.1 and figure 5 of the paper).

According to the paper, the 100 candidates for a TCP are "on a quarter of a sphere" and "Gaussian". We read
this as the sphere of radius R about the TCP. Azimuth and elevation have a normal distribution with the same
sigma about an axis. This axis is the direction from the nominal hand position to the desired TCP. A candidate
must be within 60 degrees of the axis. This cone covers exactly a quarter of the sphere. R and sigma are our
choice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import arctan2, cos, length, product, sin
from safety_harness.base.exceptions import SettingsError
from safety_harness.base.normals import standard_normal
from safety_harness.base.settings import Settings

NARROWEST_CONE_RAD = np.radians(1.0)  # rejection sampling would hardly end in a narrower cone
SAME_PLACE_M = 1e-9  # at a smaller distance, a direction is rounding or the solver's noise


@dataclass(frozen=True, eq=False)
class CandidateCap:
    """The spherical cap from which candidates are drawn.

    ``axis_in_base`` (3,) is a unit vector. The cap consists of all directions within ``cone_rad`` of this
    axis.
    """

    axis_in_base: NDArray[np.float64]
    radius_m: float
    sigma_rad: float
    cone_rad: float
    count: int

    @classmethod
    def from_settings(cls, settings: Settings) -> CandidateCap:
        """Return the cap that the settings describe.

        Its axis points from the nominal hand to the desired TCP. Raise ``SettingsError`` if the nominal hand
        and the desired TCP coincide, or if the cone is too narrow to draw from.
        """
        avoidance = settings.avoidance
        axis = np.subtract(
            settings.cell.desired_tcp_position_in_base_m, avoidance.nominal_hand_position_in_base_m
        )
        if not length(axis) > 0.0:
            expected = "a nominal hand position apart from the desired TCP position"
            raise SettingsError.of_option("nominal hand position", expected, "the same position")
        if not avoidance.candidate_cone_rad >= NARROWEST_CONE_RAD:
            expected = f"a candidate cone of at least {np.degrees(NARROWEST_CONE_RAD):.0f} deg"
            got = f"{np.degrees(avoidance.candidate_cone_rad):g} deg"
            raise SettingsError.of_option("candidate cone", expected, got)
        return cls(
            axis / length(axis),
            avoidance.radius_m,
            avoidance.candidate_sigma_rad,
            avoidance.candidate_cone_rad,
            avoidance.candidate_count,
        )

    def draw(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return offsets (count, 3) from the TCP in the base frame, each of length ``radius_m``.

        The function repeats draws that fall outside of the cone. The repetition ends soon, because some 61 %
        of the draws fall into the cone if sigma is 45 degrees.
        """
        frame = self.frame()
        kept = np.empty((0, 3))
        while len(kept) < self.count:
            azimuth, elevation = self.sigma_rad * standard_normal(
                rng, (2, 2 * self.count)
            )  # both from the axis
            along, aside = cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth)
            directions = product(
                np.stack([along, aside, sin(elevation)], axis=1), frame
            )  # (n, 3) unit vectors
            inside = product(directions, self.axis_in_base) >= cos(self.cone_rad)
            kept = np.concatenate([kept, directions[inside]])
        return self.radius_m * kept[: self.count]

    def frame(self) -> NDArray[np.float64]:
        """Return three orthogonal unit vectors as the rows of a matrix (3, 3).

        The first is the axis, the second is horizontal, and the third points upward unless the axis is
        vertical.
        """
        vertical = abs(self.axis_in_base[2]) > 1.0 - 1e-12  # then any horizontal direction is a side
        side = np.array([0.0, 1.0, 0.0]) if vertical else np.cross([0.0, 0.0, 1.0], self.axis_in_base)
        side = side - product(side, self.axis_in_base) * self.axis_in_base
        side /= length(side)
        upward = np.cross(self.axis_in_base, side)
        return np.stack([self.axis_in_base, side, upward])


def continuous_optimum(settings: Settings, tcp_in_base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of the cap that are nearest to the desired position, shape (n, 3) [m].

    The result contains one point for each TCP in ``tcp_in_base`` (n, 3).

    Let d = desired - tcp, and let R be the radius. The squared distance of a point tcp + R u from the desired
    position is R^2 - 2 R dot(u, d) + |d|^2. So the function looks for the unit vector u of the cap that is
    nearest in angle to d. If the cap contains the direction of d, u is this direction. Otherwise u points to
    the rim of the cap, in the plane of d and the cap's axis. If the TCP is at the desired position, all
    points of the cap are equally near, and the function takes the axis. If d is opposite to the axis, all
    points of the rim are equally near. The function then takes a fixed point of the rim.
    """
    cap = CandidateCap.from_settings(settings)
    axis = cap.axis_in_base
    offset = np.array(settings.cell.desired_tcp_position_in_base_m) - tcp_in_base  # (n, 3)
    along = product(offset, axis)
    aside = offset - along[:, None] * axis
    aside -= product(aside, axis)[:, None] * axis  # again, because a small remainder is mostly rounding
    distance = np.linalg.norm(offset, axis=1)
    sideways = np.linalg.norm(aside, axis=1)
    fixed = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    fixed /= length(fixed)
    there = distance <= SAME_PLACE_M
    with np.errstate(invalid="ignore"):  # 0/0 is replaced
        direct = np.where(there[:, None], axis, offset / distance[:, None])
        beside = np.where((sideways > 1e-12 * distance)[:, None], aside / sideways[:, None], fixed)
    in_cap = there | (arctan2(sideways, along) <= cap.cone_rad)
    rim = cos(cap.cone_rad) * axis + sin(cap.cone_rad) * beside
    optimum: NDArray[np.float64] = tcp_in_base + cap.radius_m * np.where(in_cap[:, None], direct, rim)
    return optimum
