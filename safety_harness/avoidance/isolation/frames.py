"""What is said between us and the process of a user's avoider: MessagePack of known kinds, no pickle.

A message goes in a frame, behind a header that tells its length.  Each side decodes what the other may say
and nothing else.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, msgpack

from safety_harness.avoidance.asking import Answer, Question
from safety_harness.avoidance.avoider import LARGEST, Proposal, printable
from safety_harness.scenario.decision_times import LONGEST_S

HEADER = struct.Struct("<4sI")  # MAGIC, bytes of the message
MAGIC = b"AVO2"
MOST_QUESTION_BYTES = 1 << 30
MOST_ANSWER_BYTES = 131_072
MOST_ANSWER_WORDS = 960  # bytes; a trace keeps 240 characters

Position = tuple[float, float, float]


class Make(Struct, tag=True):
    """Make an avoider of that number: ``wanted`` says which in JSON, ``source`` is its file."""

    number: int
    wanted: bytes
    source: bytes


class Ask(Struct, tag=True):
    """Questions of hand and TCP with seed and limit; ``together``: in one call if the avoider takes many."""

    number: int
    questions: list[tuple[Position, Position, int, float]]
    together: bool

    @classmethod
    def of(cls, number: int, questions: Sequence[Question], *, together: bool) -> Ask:
        """To the avoider of that number."""
        return cls(number, [(hand.tolist(), tcp.tolist(), *rest) for hand, tcp, *rest in questions], together)

    def asked(self) -> list[Question]:
        """Every array is a copy of its own, so that what is written into it changes nothing."""
        return [
            Question(np.array(hand), np.array(tcp), seed, limit_s)
            for hand, tcp, seed, limit_s in self.questions
        ]


class Drop(Struct, tag=True):
    """Nobody needs the avoider of that number any more."""

    number: int


class Made(Struct, tag=True):
    """What an avoider says of itself."""

    name: str
    spread_threshold_m: Annotated[float, Meta(ge=0.0, le=LARGEST)] | None
    decision_time_s: Annotated[float, Meta(ge=0.0, le=LONGEST_S)]
    takes_many: bool


class Refused(Struct, tag=True):
    """The file gives no avoider: what was expected, what came, where to read on, and in which field."""

    expected: str
    got: str
    hint: str
    field: str


class Answered(Struct, tag=True):
    """The answer to the question of that number, among those asked for."""

    number: int
    position_in_base_m: Position
    spread_m: Position
    spread_threshold_m: float
    latency_s: float
    fault: bytes

    @classmethod
    def of(cls, number: int, answer: Answer) -> Answered:
        """As much of the fault as there is room for."""
        return cls(
            number,
            answer.proposal.position_in_base_m.tolist(),
            answer.proposal.spread_m.tolist(),
            float(answer.spread_threshold_m),
            answer.latency_s,
            answer.fault.encode(errors="replace")[:MOST_ANSWER_WORDS],
        )

    def answer(self) -> Answer:
        """As it was sent, not yet looked at."""
        return Answer(
            Proposal(np.array(self.position_in_base_m), np.array(self.spread_m)),
            self.spread_threshold_m,
            printable(self.fault.decode(errors="ignore")),
            latency_s=self.latency_s,
        )


Told = Make | Ask | Drop
Said = Made | Refused | Answered
to_the_child: msgpack.Decoder[Told] = msgpack.Decoder(Told)
from_the_child: msgpack.Decoder[Said] = msgpack.Decoder(Said)


def packed(message: Struct) -> bytes:
    """A frame, as bytes."""
    payload = msgpack.encode(message)
    return HEADER.pack(MAGIC, len(payload)) + payload


def length_of(header: bytes, most: int) -> int:
    """How long the message is, which is at most ``most`` bytes; ValueError otherwise."""
    magic, length = HEADER.unpack(header)
    if magic != MAGIC or length > most:
        raise ValueError("no frame of ours")
    return int(length)
