"""An avoider in an ONNX file, loaded and asked in its own process: a file may loop, or fill the memory.

Loading is enough for that: the runtime computes at once what depends on no input.
"""

from __future__ import annotations

from pathlib import Path

from safety_harness.avoidance.isolation.host import RefusedError, Wanted, host_of
from safety_harness.avoidance.isolation.isolated import IsolatedAvoider
from safety_harness.avoidance.isolation.process import GoneError
from safety_harness.avoidance.model_file import model_bytes, refuse
from safety_harness.settings import Settings

LARGEST_BYTES = 256 * 2**20
LONGEST_S = 60.0  # to be loaded and asked twice


def isolated_onnx(path: Path, settings: Settings) -> IsolatedAvoider:
    """The avoider of the file; ModelError says what is wrong.

    It is tried with the cell's own desired TCP and nominal hand.
    """
    host = host_of(path, model_bytes(path, "an ONNX file", most=LARGEST_BYTES))
    question = {
        "hand": settings.avoidance.nominal_hand_position_in_base_m,
        "tcp": settings.cell.desired_tcp_position_in_base_m,
    }
    try:
        return IsolatedAvoider.of(host, Wanted(question, LONGEST_S))
    except RefusedError as error:
        refuse(path, error.field or None, error.expected, error.got, error.hint)
    except GoneError as error:
        within = f" within {LONGEST_S:g} s" if error.hung else ""
        refuse(path, None, f"an ONNX file that can be loaded and answers twice{within}", str(error))
