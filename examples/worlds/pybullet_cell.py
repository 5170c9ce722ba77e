"""A simulator around PyBullet, whose motors have torque limits and whose joints have stops.

safety-harness run FILE --world "exec:python3 examples/worlds/pybullet_cell.py"
"""

import json
import os
import sys
import tempfile

import numpy as np
import pybullet

SUBSTEPS = 4


def say(**message):
    print(json.dumps(message), flush=True)


def quaternion(seat):
    """Return x, y, z, w of a rotation: an eigenvector (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = seat[:3, :3]
    rows = [
        [a - e - i, 0, 0, 0],
        [d + b, e - a - i, 0, 0],
        [g + c, h + f, i - a - e, 0],
        [h - f, c - g, d - b, a + e + i],
    ]
    return np.linalg.eigh(np.array(rows) / 3.0)[1][:, 3]


class Cell:
    def __init__(self, asked):
        self.period_s = asked["period_s"]
        seat = np.array(asked["transform_seat"])
        pybullet.resetSimulation()
        pybullet.setGravity(0.0, 0.0, -9.81)
        pybullet.setTimeStep(self.period_s / SUBSTEPS)
        pybullet.setPhysicsEngineParameter(numSolverIterations=200, solverResidualThreshold=1e-18)
        with tempfile.NamedTemporaryFile("w", suffix=".urdf", delete=False) as file:
            file.write(asked["urdf"])
        self.robot = pybullet.loadURDF(file.name, seat[:3, 3], quaternion(seat), useFixedBase=True)
        os.unlink(file.name)
        info = [pybullet.getJointInfo(self.robot, k) for k in range(pybullet.getNumJoints(self.robot))]
        by_name = {joint[1].decode(): joint for joint in info}
        self.joints = [by_name[name][0] for name in asked["joint_names"]]
        self.efforts = [by_name[name][10] for name in asked["joint_names"]]
        for k in range(-1, len(info)):
            pybullet.changeDynamics(self.robot, k, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
        for joint, position_rad in zip(self.joints, asked["joint_position_rad"], strict=True):
            pybullet.resetJointState(self.robot, joint, position_rad)

    def speeds(self):
        return [state[1] for state in pybullet.getJointStates(self.robot, self.joints)]

    def step(self, radps):
        pybullet.setJointMotorControlArray(
            self.robot, self.joints, pybullet.VELOCITY_CONTROL, targetVelocities=radps, forces=self.efforts
        )
        seen = []
        for _ in range(SUBSTEPS):
            pybullet.stepSimulation()
            seen.append(self.speeds())
        return [list(map(min, zip(*seen, strict=True))), list(map(max, zip(*seen, strict=True)))]

    def say_state(self, tick, span):
        say(
            say="state",
            tick=tick,
            time_s=tick * self.period_s,
            joint_position_rad=[state[0] for state in pybullet.getJointStates(self.robot, self.joints)],
            joint_velocity_radps=self.speeds(),
            joint_velocity_range_radps=span,
        )


pybullet.connect(pybullet.DIRECT)
for line in sys.stdin:
    message = json.loads(line)
    if message["say"] == "hello":
        say(say="hello", protocol="safety-harness world 1", name="PyBullet cell", version="1")
    elif message["say"] == "reset":
        cell = Cell(message)
        rest = [0.0] * len(cell.joints)
        cell.say_state(0, [rest, rest])
    else:
        cell.say_state(message["tick"] + 1, cell.step(message["joint_velocity_radps"]))
