"""Describe the world MuJoCo for the list of worlds; this module loads no engine."""

from __future__ import annotations

from safety_harness.base.extras import MUJOCO as EXTRA
from safety_harness.cell.simulation.worlds import OpensWorld, WorldEntry


def _load() -> OpensWorld:
    """Import the class of the world."""
    with EXTRA.needed("the world MuJoCo"):
        from safety_harness.extensions.worlds.mujoco_world import MujocoWorld

    return MujocoWorld


MUJOCO = WorldEntry(
    name="mujoco",
    label="MuJoCo",
    load=_load,
    substeps=True,
    known_to_radps=1e-9,
    libraries=("mujoco",),
    reference=True,
)
"""The second reference: rigid bodies with motors that have torque limits, and no renderer."""
