"""What a controller says, spoilt in the ways that programs spoil it."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable

FRAME = b'{"say":"move","tick":3,"tcp_velocity_mps":[0.01,-0.02,0.003]}'
DEEP = 20_000
COUNTS = {"tcp_velocity_mps": 3, "tcp_angular_velocity_radps": 3, "joint_velocity_radps": 6}


def is_an_answer(frame: bytes) -> bool:
    """Is its first line an answer of finite velocities to tick 3, read by another reader of JSON?"""
    try:
        said = json.loads(frame.split(b"\n", 1)[0].decode())
    except (ValueError, RecursionError):
        return False
    if not isinstance(said, dict) or said.pop("tick", None) != 3:
        return False
    say = said.pop("say", None)
    if say == "stop":
        return not said
    return say == "move" and bool(said) and all(_is_velocity(*one) for one in said.items())


def _is_velocity(name: str, numbers: object) -> bool:
    """Of a UR10's TCP or joints."""
    if not isinstance(numbers, list) or len(numbers) != COUNTS.get(name):
        return False
    return all(isinstance(one, (int, float)) and abs(one) < math.inf for one in numbers)


def _flipped(rng: random.Random) -> bytes:
    frame = bytearray(FRAME)
    for _ in range(rng.randint(1, 8)):
        frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
    return bytes(frame)


def _cut(rng: random.Random) -> bytes:
    return FRAME[: rng.randrange(len(FRAME))]


def _without_a_part(rng: random.Random) -> bytes:
    frame = bytearray(FRAME)
    at = rng.randrange(len(frame))
    del frame[at : at + rng.randint(1, 12)]
    return bytes(frame)


def _with_noise(rng: random.Random) -> bytes:
    at = rng.randrange(len(FRAME) + 1)
    return FRAME[:at] + rng.randbytes(rng.randint(1, 40)) + FRAME[at:]


def _twice(rng: random.Random) -> bytes:
    return FRAME + rng.choice((b"", b"\n", b" ", b",")) + FRAME


def _other_number(rng: random.Random) -> bytes:
    other = rng.choice(
        (b"NaN", b"Infinity", b"1e999", b"-1e308", b"null", b'"1"', b"[1]", b"true", b"{}", b"9" * 400)
    )
    return FRAME.replace(rng.choice((b"0.01", b"-0.02", b"0.003", b"3,")), other)


def _other_shape(rng: random.Random) -> bytes:
    numbers = ",".join("0.1" for _ in range(rng.choice((0, 1, 2, 4, 6, 7, 5_000))))
    return b'{"say":"move","tick":3,"%s":[%s]}' % (
        rng.choice((b"tcp_velocity_mps", b"tcp_angular_velocity_radps", b"joint_velocity_radps")),
        numbers.encode(),
    )


def _other_message(rng: random.Random) -> bytes:
    return rng.choice(
        (
            b"",
            b"null",
            b"[]",
            b'"move"',
            b"{}",
            b'{"say":"ready"}',
            b'{"say":"jump","tick":3}',
            b'{"say":"move","tick":4}',
            b'{"say":"move","tick":-1}',
            b'{"say":"stop","tick":3,"more":1}',
            b'{"say":"stop","tick":3,"report":{"mode":"asleep"}}',
            b'{"say":"stop","tick":3,"report":{"decision":{}}}',
            b'{"say":"failed","why":"\\u001b[31mred\\u0000"}',
            b'{"say":"failed"}',
            b'{"say":"hello","protocol":"safety-harness controller 1","name":"a","sees":[]}',
            b"[" * DEEP + b"]" * DEEP,
            b'{"say":' * DEEP,
            b'{"say":"failed","why":"' + b"w" * 70_000 + b'"}',
        )
    )


MUTATIONS: dict[str, Callable[[random.Random], bytes]] = {
    "bits flipped": _flipped,
    "cut off": _cut,
    "without a part": _without_a_part,
    "with noise": _with_noise,
    "twice": _twice,
    "another number": _other_number,
    "another shape": _other_shape,
    "another message": _other_message,
}
"""One frame of what may come in place of the answer to tick 3, without the end of its line."""
