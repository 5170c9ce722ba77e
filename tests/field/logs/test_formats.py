"""The same recording gives the same verdicts, whatever the file that it is in."""

from __future__ import annotations

from binascii import crc32
from dataclasses import replace
from pathlib import Path
from struct import pack_into, unpack_from

import numpy as np
import pytest
from cells import NAMES, Streams, cell, recorded, said, words_of
from log_formats import FORMATS, joint_messages, own_messages, poses, write_bag
from rosbags.rosbag2 import StoragePlugin

from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import LogError
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.read import read_log


@pytest.fixture(scope="module")
def streams() -> Streams:
    """With a gap that is bridged, and one that is not."""
    rng = np.random.default_rng(7)
    one = cell(rng)
    found = recorded(one, rng, seconds=1.6, lost=((0.3, 0.4), (0.9, 1.2)))
    return replace(found, words=words_of(one, found))


def _log(folder: Path, text: str) -> Path:
    (folder / "LOG.yaml").write_text(text)
    return folder / "LOG.yaml"


def test_five_formats_one_verdict(streams: Streams, tmp_path: Path) -> None:
    found = {}
    for form in FORMATS:
        folder = tmp_path / form.__name__
        folder.mkdir()
        trace = trace_from_log(read_log(_log(folder, form(streams, folder)))).trace
        found[form.__name__] = [(e.sentence, e.verdict, e.reason[:60]) for e in judge(trace)], trace
    verdicts, first = found["csv"]
    assert len({verdict for _, verdict, _ in verdicts}) > 1
    for said_by, trace in found.values():
        assert said_by == verdicts
        for name in ("joint_position_rad", "hand_position_in_base_m", "hand_distance_m"):
            np.testing.assert_allclose(trace.ticks[name], first.ticks[name], atol=2e-6)


def test_a_message_of_ones_own_by_the_definition_in_the_bag(streams: Streams, tmp_path: Path) -> None:
    write_bag(tmp_path / "run", joint_messages(streams) + own_messages(streams), StoragePlugin.SQLITE3)
    text = said("run#/joint_states", "run#/wrist:wrist", "run#/elbow:wrist", "")
    (body,) = read_log(_log(tmp_path, text)).hands
    np.testing.assert_array_equal(body.hand.values, streams.hand_m[: len(body.hand.values)])
    with pytest.raises(LogError, match="say which field of it"):
        read_log(_log(tmp_path, text.replace("/wrist:wrist", "/wrist")))


def test_joints_by_the_names_of_the_log(streams: Streams, tmp_path: Path) -> None:
    own = tuple(f"axis_{k}" for k in range(6))
    write_bag(tmp_path / "run", joint_messages(streams, own) + poses(streams), StoragePlugin.MCAP)
    text = said("run#/joint_states", "run#/hand", "run#/elbow", "")
    with pytest.raises(LogError, match='expected the joint "shoulder_pan_joint"'):
        read_log(_log(tmp_path, text))
    named = ", ".join(f"{ours}: {theirs}" for ours, theirs in zip(NAMES, own, strict=True))
    joints = read_log(_log(tmp_path, text.replace("joints: {known", f"joints: {{names: {{{named}}}, known")))
    np.testing.assert_array_equal(joints.joints.values[:, :6], streams.joints_rad)


def test_hands_in_an_unknown_frame_are_refused(streams: Streams, tmp_path: Path) -> None:
    folder = tmp_path
    text = FORMATS[-1](streams, folder).replace("frame: {tf: 'run#/tf_static'}", "")
    with pytest.raises(LogError, match='the frame "tracker"'):
        read_log(_log(folder, text))


def test_a_topic_that_is_not_there_is_told_with_those_that_are(streams: Streams, tmp_path: Path) -> None:
    write_bag(tmp_path / "run", joint_messages(streams) + poses(streams), StoragePlugin.SQLITE3)
    with pytest.raises(LogError, match="joint_states") as refused:
        read_log(_log(tmp_path, said("run#/joint_state", "run#/hand", "run#/elbow", "")))
    assert refused.value.hint


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_a_bag_that_was_cut_off_is_refused(streams: Streams, tmp_path: Path, share: float) -> None:
    for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
        bag = write_bag(tmp_path / storage.name, joint_messages(streams) + poses(streams), storage)
        (data,) = (one for one in bag.iterdir() if one.suffix in (".db3", ".mcap"))
        data.write_bytes(data.read_bytes()[: int(data.stat().st_size * share)])
        name = storage.name
        with pytest.raises(LogError) as refused:
            read_log(_log(tmp_path, said(f"{name}#/joint_states", f"{name}#/hand", f"{name}#/elbow", "")))
        assert refused.value.place.file is not None


def test_a_byte_that_was_changed_in_a_recording_with_checksums_is_refused(
    streams: Streams, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "run", joint_messages(streams) + poses(streams), StoragePlugin.MCAP)
    (data,) = bag.glob("*.mcap")
    log = _log(tmp_path, said("run#/joint_states", "run#/hand", "run#/elbow", ""))
    content, middles = bytearray(data.read_bytes()), []
    at = 8
    while content[at] != 0x02:  # the footer
        (length,) = unpack_from("<Q", content, at + 1)
        if content[at] == 0x06:  # a chunk: two times, its size, its checksum, which this writer leaves out
            (named,), start = unpack_from("<I", content, at + 37), at + 9 + length
            (stored,) = unpack_from("<Q", content, at + 41 + named)
            pack_into("<I", content, at + 33, crc32(content[start - stored : start]))
            middles.append(start - stored // 2)
        at += 9 + length
    data.write_bytes(content)
    read_log(log)
    content[middles[0]] ^= 1
    data.write_bytes(content)
    with pytest.raises(LogError, match="checksum") as refused:
        read_log(log)
    assert refused.value.place.file is not None
