"""What is said between us and the process of a user's avoider: MessagePack of known kinds, no pickle.

Each side decodes what the other may say and nothing else.
"""

from __future__ import annotations

from operator import methodcaller
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct, msgpack

from safety_harness.cell.avoidance.asking import Answer, Question
from safety_harness.cell.avoidance.avoider import LARGEST, Vector
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.seams.rows import PackedSeen, packed_seen, unpacked

MOST_QUESTION_BYTES = 1 << 30
MOST_ANSWER_BYTES = 131_072
MOST_ANSWER_WORDS = 960  # bytes; a trace keeps 240 characters


class Make(Struct, tag=True):
    """Make an avoider of that number: ``wanted`` says which in JSON, ``source`` is its file."""

    number: int
    wanted: bytes
    source: bytes


class Ask(Struct, tag=True):
    """Questions to the avoider of that number; ``together``: in one call if it takes many.

    ``seen`` is what goes with each, for an avoider that sees more.
    """

    number: int
    questions: list[Question]
    together: bool
    seen: list[PackedSeen] = []

    @classmethod
    def of(cls, number: int, questions: list[Question], together: bool) -> Ask:
        """Those questions, what is seen apart from them."""
        seen = [packed_seen(one.seen) for one in questions if one.seen is not None]
        return cls(number, [one._replace(seen=None) for one in questions], together, seen)

    @property
    def asked(self) -> list[Question]:
        """The questions as they were."""
        if not self.seen:
            return self.questions
        pairs = zip(self.questions, self.seen, strict=True)
        return [question._replace(seen=unpacked(seen)) for question, seen in pairs]


class Drop(Struct, tag=True):
    """Nobody needs the avoider of that number any more."""

    number: int


class Made(Struct, tag=True):
    """What an avoider says of itself."""

    name: str
    spread_threshold_m: Annotated[float, Meta(ge=0.0, le=LARGEST)] | None
    decision_time_s: Annotated[float, Meta(ge=0.0, le=LONGEST_S)]
    takes_many: bool
    sees: tuple[str, ...]


class Refused(Struct, tag=True):
    """The file gives no avoider: what was expected, what came, where to read on, and in which field."""

    expected: str
    got: str
    hint: str
    field: str


class Answered(Struct, tag=True):
    """The answer to the question of that number, among those asked for, not yet looked at."""

    number: int
    answer: Answer


def _vector(kind: type, value: object) -> Vector:
    """(3,), of its own, so that what is written into it changes nothing."""
    return np.array(msgspec.convert(value, tuple[float, float, float]))


Told = Make | Ask | Drop
Said = Made | Refused | Answered
to_the_child: msgpack.Decoder[Told] = msgpack.Decoder(Told, dec_hook=_vector)
from_the_child: msgpack.Decoder[Said] = msgpack.Decoder(Said, dec_hook=_vector)


def packed(message: Struct) -> bytes:
    """The message, as bytes."""
    return msgpack.encode(message, enc_hook=methodcaller("tolist"))
