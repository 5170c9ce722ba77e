"""A simulator in which every joint follows its set point: the least that a world can be.

safety-harness run FILE --world "exec:python3 examples/worlds/kinematic_cell.py"
"""

import json
import sys


def say(**message):
    print(json.dumps(message), flush=True)


def state(tick, period_s, joints_rad, speeds_radps, least_radps, most_radps):
    say(
        say="state",
        tick=tick,
        time_s=tick * period_s,
        joint_position_rad=joints_rad,
        joint_velocity_radps=speeds_radps,
        joint_velocity_range_radps=[least_radps, most_radps],  # since the tick before
    )


for line in sys.stdin:
    message = json.loads(line)
    if message["say"] == "hello":
        say(say="hello", protocol="safety-harness world 1", name="kinematic cell", version="1")
    elif message["say"] == "reset":  # forget the episode before; message["urdf"] describes the arm
        period_s, joints_rad = message["period_s"], message["joint_position_rad"]
        rest = [0.0] * len(joints_rad)
        state(0, period_s, joints_rad, rest, rest, rest)
    else:  # a step
        speeds_radps = message["joint_velocity_radps"]
        joints_rad = [q + dq * period_s for q, dq in zip(joints_rad, speeds_radps, strict=True)]
        state(message["tick"] + 1, period_s, joints_rad, speeds_radps, speeds_radps, speeds_radps)
