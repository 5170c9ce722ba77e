"""A program that speaks the protocol, well or not, and what it is told."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import numpy as np

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.controller.driven import arm_of
from safety_harness.cell.controller.named import controller_of
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.scenario.robots import Robot
from safety_harness.seams.contract import Seen, SeenHand, Start, UserController

PROGRAM = '''\
"""Moves slowly up; given a way and a file, it misbehaves so at tick 3 while the file is there."""

import json
import os
import sys
import time

HELLO = {"say": "hello", "protocol": "safety-harness controller 1", "name": "upwards", "sees": ["joints"]}
LINE = '{"say":"move","tick":3,"tcp_velocity_mps":[0,0,0.01]}'


WAYS = {
    "exit": lambda: os._exit(3),
    "killed": lambda: os.kill(os.getpid(), 9),
    "hang": lambda: time.sleep(600),
    "garbage": lambda: "}{",
    "nothing": lambda: "",
    "no object": lambda: "[1, 2]",
    "not a number": lambda: LINE.replace("0.01", "NaN"),
    "not finite": lambda: LINE.replace("0.01", "1e999"),
    "text for numbers": lambda: LINE.replace("0.01", '"up"'),
    "wrong shape": lambda: LINE.replace("0,0,", ""),
    "another tick": lambda: LINE.replace(":3", ":2"),
    "an unknown field": lambda: LINE.replace("}", ',"speed":1}'),
    "an unknown message": lambda: LINE.replace("move", "dance"),
    "hello again": lambda: json.dumps(HELLO),
    "a mode that is none": lambda: LINE.replace("}", ',"report":{"mode":"dancing"}}'),
    "failed": lambda: '{"say":"failed","why":"no way \\\\n out"}',
    "deep": lambda: "[" * 100_000,
    "flood": lambda: [sys.stdout.write("x" * 65_536) for _ in range(10_000)],
    "flood of errors": lambda: [os.write(2, b"x" * 65_536) for _ in iter(int, 1)],
    "memory": lambda: bytearray(5 << 30),
    "flood of lines": lambda: "\\n".join([LINE] * 10_000),
}

way, file = sys.argv[1:] or ("", "")
for line in sys.stdin:
    told = json.loads(line)
    broken = way and os.path.exists(file)
    if told["say"] == "hello":
        print(json.dumps(HELLO), flush=True)
    elif told["say"] == "reset":
        print('{"say":"ready"}', flush=True)
    elif broken and way == "says" and told["tick"] == 3:
        sys.stdout.buffer.write(open(file, "rb").read() + b"\\n")
        sys.stdout.flush()
    elif broken and told["tick"] == 3:
        print(WAYS[way](), flush=True)
    else:
        print(LINE.replace(":3", ":%d" % told["tick"]), flush=True)
'''
WAYS = re.findall(r'^    "([^"]+)": lambda', PROGRAM, re.MULTILINE)


def program(folder: Path, way: str = "", file: Path = Path("break")) -> str:
    """A reference to the program, which is written into the folder; it misbehaves while the file is there."""
    (folder / "program.py").write_text(PROGRAM)
    words = [sys.executable, "-S", str(folder / "program.py"), *((way, str(file)) if way else ())]
    return f"exec:{shlex.join(words)}"


def made(reference: str) -> UserController:
    """The controller of a reference."""
    return controller_of(reference, None)()


ARM = arm_of(arm_model(Robot.UR10))
START = Start(joint_position_rad=np.zeros(6), transform_tcp_to_base=np.eye(4))


def seen(tick: int) -> Seen:
    """At a tick: the arm, and a hand."""
    pose = links_in_base(arm_model(Robot.UR10), np.full(6, 0.001 * tick))[-1]
    return Seen(
        time_s=0.008 * tick,
        period_s=0.008,
        joint_position_rad=np.full(6, 0.001 * tick),
        joint_velocity_radps=np.zeros(6),
        transform_tcp_to_base=pose,
        tcp_position_in_base_m=pose[:3, 3],
        hands=(SeenHand(position_in_base_m=np.array([0.5, -0.2, 0.3])),),
    )


def driven(controller: UserController, ticks: int = 6, settings: Settings = DEFAULTS) -> list[object]:
    """The actions of an episode."""
    controller.reset(settings=settings, arm=ARM, start=START, seed=2**63 + 1)
    return [controller.act(seen(tick)) for tick in range(ticks)]
