"""What is said between us and the process of a user's avoider: frames of fixed layout, no pickle.

A frame is a header and a payload whose length the header tells.  Questions and answers are arrays of
records; what has words is JSON, at most ``MOST_WORDS`` bytes of it.
"""

from __future__ import annotations

import json
import struct
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from safety_harness.avoidance.asking import Answer, Question
from safety_harness.avoidance.avoider import Proposal, printable

HEADER = struct.Struct("<4sBxxxIQ")  # MAGIC, kind, bytes of payload, number
MAGIC = b"AVO1"
MOST_WORDS = 65_536
MOST_ANSWER_WORDS = 960  # bytes; a trace keeps 240 characters

QUESTION = np.dtype(
    [
        ("hand_position_in_base_m", "<f8", (3,)),
        ("tcp_position_in_base_m", "<f8", (3,)),
        ("seed", "<u8"),
        ("limit_s", "<f8"),
    ]
)
ANSWER = np.dtype(
    [
        ("position_in_base_m", "<f8", (3,)),
        ("spread_m", "<f8", (3,)),
        ("spread_threshold_m", "<f8"),
        ("latency_s", "<f8"),
        ("fault", f"S{MOST_ANSWER_WORDS}"),
    ]
)


class FrameKind(IntEnum):
    """What a frame says; its number is that of an avoider, or of an answer among those asked for."""

    MAKE = 1  # JSON, a zero byte, the source
    ASK_IN_TURN = 2  # (n,) QUESTION
    ASK_TOGETHER = 3  # the same, in one call if the avoider takes many
    DROP = 4  # nothing
    MADE = 5  # JSON
    REFUSED = 6  # JSON
    ANSWER = 7  # (1,) ANSWER


class Frame(NamedTuple):
    """One message."""

    kind: FrameKind
    number: int
    payload: bytes


class NonsenseError(Exception):
    """What came is no frame of ours."""


def packed(kind: FrameKind, number: int, payload: bytes = b"") -> bytes:
    """A frame, as bytes."""
    return HEADER.pack(MAGIC, kind, len(payload), number) + payload


def unpacked_header(header: bytes, most: int) -> tuple[FrameKind, int, int]:
    """Kind, number and the length of the payload, which is at most ``most``; NonsenseError otherwise."""
    magic, kind, length, number = HEADER.unpack(header)
    if magic != MAGIC or kind not in set(FrameKind) or length > most:
        raise NonsenseError
    return FrameKind(kind), number, length


def questions_as_bytes(questions: list[Question]) -> bytes:
    """(n,) QUESTION."""
    records = np.zeros(len(questions), QUESTION)
    for record, question in zip(records, questions, strict=True):
        for name, value in question._asdict().items():
            record[name] = value
    return records.tobytes()


def questions_from(payload: bytes) -> list[Question]:
    """Every array is a copy of its own, so that what is written into it changes nothing."""
    return [
        Question(
            record["hand_position_in_base_m"].astype(np.float64),
            record["tcp_position_in_base_m"].astype(np.float64),
            int(record["seed"]),
            float(record["limit_s"]),
        )
        for record in np.frombuffer(payload, QUESTION)
    ]


def answer_as_bytes(answer: Answer) -> bytes:
    """(1,) ANSWER; of the fault as many words as there is room for."""
    record = np.zeros(1, ANSWER)
    record["position_in_base_m"] = answer.proposal.position_in_base_m
    record["spread_m"] = answer.proposal.spread_m
    for name in ("spread_threshold_m", "latency_s"):
        record[name] = getattr(answer, name)
    record["fault"] = answer.fault.encode(errors="replace")[:MOST_ANSWER_WORDS]
    return record.tobytes()


def answer_from(payload: bytes) -> Answer:
    """The answer as it was sent, not yet looked at; NonsenseError for another length."""
    if len(payload) != ANSWER.itemsize:
        raise NonsenseError
    record = np.frombuffer(payload, ANSWER)[0]
    return Answer(
        Proposal(record["position_in_base_m"].copy(), record["spread_m"].copy()),
        float(record["spread_threshold_m"]),
        printable(bytes(record["fault"]).decode(errors="ignore")),
        latency_s=float(record["latency_s"]),
    )


def words_from(payload: bytes) -> dict[str, Any]:
    """A JSON object; NonsenseError if it is none."""
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise NonsenseError from error
    if not isinstance(found, dict):
        raise NonsenseError
    return found
