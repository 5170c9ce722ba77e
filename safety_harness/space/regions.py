"""Named regions: the space that an avoider saw in training, and the shells around that space (Table 3).

The paper gives only the bounds of the seen hands (nominal +- 300 mm, section 4.1).  We chose the remaining
bounds before any result, for these reasons:

* Seen TCPs lie within +-(60, 150, 100) mm of the desired position.  The range of x is the narrowest, as in
  the paper.  In the default cell, the arm can reach every point of that box, and the object is then in view.
* Unseen TCPs lie outside that box, and inside a box of twice its size.  This region borders on the seen box.
  A TCP that retreats by R = 100 mm from the edge of the seen box therefore ends in this region.  The region
  has seven eighths of the larger box's volume.  In the default cell the arm reaches all of these TCPs.  At
  about a fifth of them, the object is partly out of view.
* Unseen hands lie outside the seen box, and inside a box of 1.5 times its size.  No hand's centre is below
  the table's top.  A hand only shifts the target by 0.05 of its own displacement (eq. 13), so a larger box
  would add little.  In a box of twice the size, hands would overlap with the arm's own links.

If a network's file states the bounds of its training data, the regions use these bounds.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from safety_harness.base.exceptions import ModelError, RegionError, near_miss
from safety_harness.base.geometry.regions import Box, Region
from safety_harness.base.settings import Settings, Vector3
from safety_harness.base.shipped.contents import located
from safety_harness.cell.avoidance.model_file import (
    KEY,
    NetworkUse,
    SeenSpace,
    load_model,
    network_use,
    onnx_bytes,
    onnx_metadata,
)
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.scenario.references import MODEL_SUFFIX, file_and_name, names_onnx
from safety_harness.scenario.typed_json import parsed

# Half sizes of the training space, of which x is the narrowest, as in the paper. In 10,000 draws, the UR10
# could reach every TCP, with the object in view.
SEEN_TCP_HALF_SIZE_M: Vector3 = (0.060, 0.150, 0.100)
SEEN_HAND_HALF_SIZE_M: Vector3 = (0.300, 0.300, 0.300)
# A choice: an unseen space is the grown box without the seen box.
UNSEEN_TCP_FACTOR = 2.0
UNSEEN_HAND_FACTOR = 1.5
REGIONS = ("seen hand", "unseen hand", "seen tcp", "unseen tcp")


@dataclass(frozen=True)
class SeenRegions:
    """The boxes of hands and TCPs that an avoider saw in training, in the base frame.

    ``source`` states the origin of the boxes, which is an avoider or the paper.
    """

    hand: Box
    tcp: Box
    source: str


def paper_seen(settings: Settings, source: str = "the paper") -> SeenRegions:
    """Return the seen space of the paper.

    TCPs lie around the desired position, and hands around the nominal hand position.
    """
    return SeenRegions(
        hand=Box.centred_at(settings.avoidance.nominal_hand_position_in_base_m, SEEN_HAND_HALF_SIZE_M),
        tcp=Box.centred_at(settings.cell.desired_tcp_position_in_base_m, SEEN_TCP_HALF_SIZE_M),
        source=source,
    )


def seen_by(avoider: str, *, folder: Path | None, settings: Settings) -> SeenRegions:
    """Return the space that a scenario's avoider saw in training, according to the metadata of its file.

    The function reads the metadata of a network and runs no user program.  If an avoider has no metadata, the
    result is the seen space of the paper, and ``source`` states this.

    Args:
        avoider: The avoider's reference.
        folder: The folder to which file paths are relative.  None means the working directory.
        settings: The settings with the desired TCP and the nominal hand.

    Raises:
        ModelError: A model file cannot be used.

    """
    path = located((folder or Path()) / os.path.expanduser(file_and_name(avoider)[0]))
    seen: SeenSpace | None = None
    if avoider in SHIPPED or avoider.endswith(MODEL_SUFFIX):
        seen = load_model(shipped_model(avoider) if avoider in SHIPPED else path).seen
    elif names_onnx(avoider):
        exported = exported_use(path)
        seen = exported.seen if exported else None
    if seen is None:
        return paper_seen(settings, f"the paper, as {avoider} does not say what it has seen")
    hand, tcp = Box(seen.hand_low_m, seen.hand_high_m), Box(seen.tcp_low_m, seen.tcp_high_m)
    return SeenRegions(hand=hand, tcp=tcp, source=avoider)


def region_named(name: str, seen: SeenRegions, settings: Settings) -> Region:
    """Return the region called ``name``, in the base frame.

    Args:
        name: A member of ``REGIONS``.
        seen: The avoider's seen space.
        settings: The settings with the height of the table.

    Raises:
        RegionError: The name is unknown.

    """
    if name == "seen hand":
        return Region(seen.hand)
    if name == "seen tcp":
        return Region(seen.tcp)
    if name == "unseen tcp":
        return Region(seen.tcp.grown(UNSEEN_TCP_FACTOR), seen.tcp)
    if name == "unseen hand":
        outer = seen.hand.grown(UNSEEN_HAND_FACTOR)
        x, y, z = outer.low_m
        above_table_m = min(max(z, settings.cell.table_height_m), seen.hand.low_m[2])
        return Region(Box((x, y, above_table_m), outer.high_m), seen.hand)
    raise RegionError.of_option("in", f"one of {', '.join(REGIONS)}", repr(name), near_miss(name, REGIONS))


def exported_use(path: Path) -> NetworkUse | None:
    """Return the data of the network in an ONNX file that this package has exported.

    Return None for any other file.
    """
    text = onnx_metadata(path, onnx_bytes(path)).get(KEY)
    if text is None:
        return None
    return network_use(parsed(text, path, "metadata", ModelError), NetworkUse, path, unknown_fields=True)
