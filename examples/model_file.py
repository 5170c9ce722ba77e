"""A model file of one's own: every tensor of the architecture, for weights from anywhere.

    python model_file.py constant.safetensors  # safety-harness copy shipped:model_file.py
    safety-harness run shipped:hand-visits-and-leaves --avoider constant.safetensors

With all weights zero the network answers 0 in normalised units, which is the mean of the targets:
always the same position.
"""

import sys
from pathlib import Path

import numpy as np

from safety_harness.cell.avoidance.model_file import Dropout, Model, SeenSpace, save_model, tensor_shapes


def constant_model(position_in_base_m: tuple[float, float, float]) -> Model:
    """A network that proposes ``position_in_base_m`` whatever it is asked."""
    tensors = {f"0/{name}": np.zeros(shape, np.float32) for name, shape in tensor_shapes().items()}
    for name, tensor in tensors.items():
        if name.endswith("running_var"):
            tensor[:] = 1.0
    return Model(
        dropout=Dropout.NONE,
        dropout_probability=0.0,
        members=1,
        passes=1,
        input_mean=(0.84, -0.35, 0.005, 0.7, 0.0, 0.35),  # the hand, then the TCP [m]
        input_std=(0.17, 0.17, 0.17, 0.035, 0.087, 0.058),
        target_mean=position_in_base_m,
        target_std=(0.1, 0.1, 0.1),
        seen=SeenSpace(
            hand_low_m=(0.54, -0.65, -0.295),
            hand_high_m=(1.14, -0.05, 0.305),
            tcp_low_m=(0.64, -0.15, 0.25),
            tcp_high_m=(0.76, 0.15, 0.45),
        ),
        calibration=None,
        card={"about": "an example: no training, no evidence"},
        tensors=tensors,
    )


if __name__ == "__main__":
    save_model(constant_model((0.66, 0.05, 0.45)), Path(sys.argv[1]))
