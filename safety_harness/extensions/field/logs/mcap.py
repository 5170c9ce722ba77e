"""Read MCAP files of any profile except ROS 2's.

The reader returns the channels, and the messages as undecoded bytes. It uses functions of the package
``rosbags`` to read the parts of a file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from struct import unpack
from typing import Any, BinaryIO

MAGIC = b"\x89MCAP0\r\n"
# Opcodes of records in the MCAP format.
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
FORMATS = {"ros2msg": "MSG", "ros1msg": "MSG", "ros2idl": "IDL", "omgidl": "IDL"}


class McapFile:
    """A reader with the same interface as the readers of ``rosbags``.

    The list ``connections`` is complete only after a call of ``open``.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self.connections: list[Any] = []

    def open(self) -> None:
        """Read the channels, and count their messages; raise ValueError if the file was cut off."""
        self._data = self._file.open("rb")
        try:
            self._read_channels()
        except BaseException:
            self.close()
            raise

    def _read_channels(self) -> None:
        from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition
        from rosbags.interfaces import MessageDefinitionFormat as Format
        from rosbags.rosbag2.storage_mcap import read_bytes, read_string

        begin = self._data.read(len(MAGIC))
        self._data.seek(-len(MAGIC), 2)
        if (begin, self._data.read()) != (MAGIC, MAGIC):
            raise ValueError("no MCAP file from its beginning to its end")
        schemas: dict[int, tuple[str, str, Any]] = {}
        channels: dict[int, tuple[int, str, str]] = {}
        counts: Counter[int] = Counter()
        for kind, record in self._records():
            if kind == SCHEMA:
                (number,) = unpack("<H", record.read(2))
                schemas[number] = read_string(record), read_string(record), read_bytes(record)
            elif kind == CHANNEL:
                number, schema = unpack("<HH", record.read(4))
                channels[number] = schema, read_string(record), read_string(record)
            elif kind == MESSAGE:
                counts.update(unpack("<H", record.read(2)))
        for number, (schema, topic, encoding) in channels.items():
            name, form, data = schemas.get(schema, ("", "", b""))
            known, named = FORMATS.get(form), name.replace("/", "/msg/") if name.count("/") == 1 else name
            text = MessageDefinition(Format[known or "NONE"], data.decode() if known else data)
            extra = ConnectionExtRosbag2(encoding, [])
            self.connections.append(Connection(number, topic, named, text, "", counts[number], extra, self))

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def messages(self, connections: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield the connection, the time of receipt [ns] and the bytes of each message."""
        wanted = {link.id: link for link in connections}
        for kind, record in self._records():
            if kind == MESSAGE:
                number, _, received_ns, _ = unpack("<HIQQ", record.read(22))
                if number in wanted:
                    yield wanted[number], received_ns, record.read()

    def _records(self) -> Iterator[tuple[int, BinaryIO]]:
        """Yield the kind and the content of each record, including the records inside chunks."""
        from rosbags.rosbag2.storage_mcap import decompress, read_exact, read_sized, read_string

        self._data.seek(len(MAGIC))
        while (kind := read_exact(self._data, 1)[0]) != FOOTER:
            record = BytesIO(read_sized(self._data))
            if kind != CHUNK:
                yield kind, record
                continue
            _, _, size, checksum = unpack("<QQQI", record.read(28))
            compression = read_string(record)
            inner = BytesIO(decompress(read_sized(record), compression, size, checksum))
            while inner.tell() < size:
                yield read_exact(inner, 1)[0], BytesIO(read_sized(inner))
