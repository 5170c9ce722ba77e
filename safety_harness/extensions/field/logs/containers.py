"""Open bags, and decode each message with the definition of its own type.

``rosbags`` reads ROS 1 and ROS 2 bags. ``safety_harness.extensions.field.logs.mcap`` reads MCAP files of any
other profile, with messages in ROS 2's encoding, JSON or Protobuf.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from safety_harness.extensions.field.logs.mcap import McapFile

ROS1, MCAP = ".bag", ".mcap"
Decode = Callable[[bytes], Any]


class UnreadableDefinitionError(Exception):
    """The error for a message type whose definition cannot be used."""


class Bag:
    """An open bag.

    The ``connections`` are objects of the package ``rosbags``; each topic has at least one connection.
    """

    def __init__(self, storage: Any, *, ros1: bool) -> None:
        self._storage, self._ros1 = storage, ros1
        self.connections: list[Any] = list(storage.connections)

    def messages(self, connections: list[Any]) -> Iterator[tuple[Any, int, Any]]:
        """Yield (connection, time of receipt [ns], content) for each message, in the order of receipt."""
        decoders: dict[int, Decode] = {}
        for connection, received_ns, raw in self._storage.messages(connections):
            if connection.id not in decoders:
                decoders[connection.id] = self._decoder(connection)
            yield connection, received_ns, decoders[connection.id](raw)

    def _decoder(self, connection: Any) -> Decode:
        """Return the decoder of a connection's messages; raise UnreadableDefinitionError if that fails."""
        encoding = getattr(connection.ext, "serialization_format", "cdr")
        try:
            if encoding == "json":
                return lambda raw: json.loads(raw, object_hook=lambda entries: SimpleNamespace(**entries))
            if encoding == "protobuf":
                return _protobuf(connection.msgtype, connection.msgdef[1])
            if encoding not in ("cdr", "ros1"):
                raise ValueError(f"messages encoded as {encoding}")
            return _ros(connection, ros1=self._ros1 or encoding == "ros1")
        except ModuleNotFoundError:
            raise
        except Exception as error:  # a wrong definition may raise anything
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise UnreadableDefinitionError(f"{connection.msgtype}: {reason}") from error


def _ros(connection: Any, *, ros1: bool) -> Decode:
    """Return the decoder for a message type.

    It uses the definition in the bag, or the standard definition if the bag contains no definition.
    """
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    kind, (form, text) = connection.msgtype, connection.msgdef
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if form.name != "NONE":
        store, bar = get_typestore(Stores.EMPTY), "=" * 80 + "\nIDL: "
        parts = [part.partition("\n")[2] for part in text.split(bar)[1:]] or [text]
        types = [get_types_from_msg(text, kind)] if form.name == "MSG" else map(get_types_from_idl, parts)
        store.register({name: fields for part in types for name, fields in part.items()})
    hashed = (lambda part: store.generate_msgdef(part)[1]) if ros1 else store.hash_rihs01
    if connection.digest and (have := hashed(kind)) != connection.digest:
        raise ValueError(f"hash mismatch {have} != {connection.digest}")
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    return lambda raw: read(raw, kind)


def _protobuf(name: str, definition: bytes) -> Decode:
    """Return a Protobuf decoder; ``definition`` contains the file descriptors in the channel's schema."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(definition).file:
        pool.Add(file)
    decode: Decode = message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString
    return decode


@contextmanager
def opened(file: Path) -> Iterator[Bag]:
    """Open the bag in a file or folder.

    Raise ImportError if ``rosbags`` is missing; a damaged bag may raise any error.
    """
    storage, ros1 = _storage(file), file.suffix.lower() == ROS1
    storage.open()
    try:
        yield Bag(storage, ros1=ros1)
    finally:
        storage.close()


def _storage(file: Path) -> Any:
    """Return the reader of a bag.

    If a folder's metadata state no storage, the suffix of its files determines the storage.
    """
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    if file.is_dir():
        storages = Reader2.STORAGE_PLUGINS
        storage: Any = storages["dir"](file)
        endings = {part.suffix for part in file.iterdir() if part.suffix in storages}
        if len(endings) == 1:
            storage.STORAGE_PLUGINS = {**storage.STORAGE_PLUGINS, "": storages[endings.pop()]}
        return storage
    ending = file.suffix.lower()
    if ending == MCAP:
        with file.open("rb") as data:
            if data.read(25)[17:] != b"\4\0\0\0ros2":  # the profile of the file
                return McapFile(file)
    return Reader1(file) if ending == ROS1 else Reader2.STORAGE_PLUGINS[ending](file)
