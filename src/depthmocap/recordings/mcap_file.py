"""MCAP files, read record by record from a memory map (specification: mcap.dev/spec).

The reader does not need the summary at the file's end: from a file that was cut off at any byte it reads every record
before the cut, also in an unfinished chunk. Chunks without compression are read in place.
"""

from __future__ import annotations

import dataclasses
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError, missing_extra

#: Largest size (bytes) of an unpacked chunk, against damaged files that claim more.
LARGEST_CHUNK = 1 << 28
#: First and last bytes of every file.
MAGIC = b"\x89MCAP0\r\n"
#: Head of a record: opcode and length.
_HEAD = struct.Struct("<BQ")
#: Head of a chunk: first and last log time, unpacked size and checksum.
_CHUNK_HEAD = struct.Struct("<QQQI")
#: Head of a message: channel, sequence number, log time and publish time.
_MESSAGE_HEAD = struct.Struct("<HIQQ")
#: Opcodes of records.
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0C, 0x0F
#: All opcodes of the specification.
_KNOWN = frozenset(range(0x01, 0x10))


class _DamageError(InputError):
    """A chunk that cannot be unpacked."""


@dataclasses.dataclass(frozen=True)
class Channel:
    """A channel and its schema."""

    id: int
    topic: str
    encoding: str
    metadata: dict[str, str]
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclasses.dataclass(frozen=True)
class Message:
    """The place of a message: its payload is ``data[start:end]`` of the chunk at byte ``chunk``; -1 means the file."""

    channel: int
    log_time_ns: int
    chunk: int
    start: int
    end: int


class McapFile:
    """The index of a file, made in one pass; payloads are read on request. A context manager.

    Attributes:
        channels: channels by id.
        metadata: entries of the metadata records, by name.
        messages: messages in the order of the file.
        problems: other records that cannot be read, one line each.
        complete: whether the file was finished; otherwise it was cut off, or is being written.
        sound_end: the byte after the last whole record.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file cannot be read, or is not MCAP."""
        self.path = path
        with open_file(path) as file:
            try:
                start = file.read(len(MAGIC))
                if start == MAGIC:
                    self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except OSError as error:
                raise InputError(f"{path} cannot be read: {error.strerror}") from None
        if start != MAGIC:
            if start and MAGIC.startswith(start):
                raise InputError(f"{path} was cut off within its first bytes: nothing is in it")
            if start[:5] == MAGIC[:5]:
                raise InputError(f"{path} is MCAP of another version than 0: convert it with the mcap tool")
            raise InputError(f"{path} is not an MCAP file")
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.messages: list[Message] = []
        self.problems: list[str] = []
        self.complete = False
        self.sound_end = len(MAGIC)
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._checked: set[int] = set()
        self._unpacked: tuple[int, bytes] = (-1, b"")  # the chunk that was unpacked last
        self._scan()

    def __enter__(self) -> McapFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def head(self, message: Message, length: int) -> bytes:
        """The message's first bytes, without a check of their checksum."""
        return self._bytes(message, message.start, min(message.end, message.start + length))

    def payload(self, message: Message) -> bytes:
        """The message's bytes.

        Raises:
            InputError: when the checksum of its chunk is wrong.
        """
        if message.chunk >= 0 and message.chunk not in self._checked:
            compression, start, end, _, crc = self._chunk(message.chunk)
            # A chunk that was cut off has no checksum to compare; compressed chunks are checked when they are unpacked.
            if not compression and crc and end <= len(self._map):
                if zlib.crc32(memoryview(self._map)[start:end]) != crc:
                    raise InputError(f"{self.path}: the data at byte {start} are damaged (checksum)")
                self._checked.add(message.chunk)
        return self._bytes(message, message.start, message.end)

    def _bytes(self, message: Message, start: int, end: int) -> bytes:
        if message.chunk < 0:
            return self._map[start:end]
        compression, first, *_ = self._chunk(message.chunk)
        return self._unpack(message.chunk)[start:end] if compression else self._map[first + start : first + end]

    def _chunk(self, offset: int) -> tuple[str, int, int, int, int]:
        """Compression, first and last byte of the records, unpacked size and checksum of a chunk."""
        _, _, size, crc = _CHUNK_HEAD.unpack_from(self._map, offset)
        at_name = offset + _CHUNK_HEAD.size
        (length,) = struct.unpack_from("<I", self._map, at_name)
        compression = bytes(self._map[at_name + 4 : at_name + 4 + min(length, 16)]).decode("utf-8", "replace")
        at_size = at_name + 4 + length
        (stored,) = struct.unpack_from("<Q", self._map, at_size)
        return compression, at_size + 8, at_size + 8 + stored, size, crc

    def _unpack(self, offset: int) -> bytes:
        if self._unpacked[0] == offset:
            return self._unpacked[1]
        compression, start, end, size, crc = self._chunk(offset)
        packed, damaged = self._map[start:end], f"{self.path}: the chunk at byte {start} is damaged"
        if size > LARGEST_CHUNK:
            raise _DamageError(f"{damaged}: it says that it unpacks to {size:,} bytes")
        try:
            # At most the size that the chunk states is unpacked, plus one byte that shows whether there is more.
            if compression == "zstd":
                import zstandard

                with zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(packed) as stream:
                    records = stream.read(size + 1)
            elif compression == "lz4":
                import lz4.frame

                records = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
            else:
                raise InputError(f"{self.path}: chunks compressed by {compression!r} are not known: zstd and lz4 are")
        except ModuleNotFoundError as error:
            raise missing_extra(error.name or "zstandard", "record") from None
        except InputError:
            raise
        except Exception as error:  # each library has its own errors
            raise _DamageError(f"{damaged}: {error}") from None
        if len(records) != size:
            raise _DamageError(f"{damaged}: it does not unpack to the {size:,} bytes that it says")
        if crc and zlib.crc32(records) != crc:
            raise _DamageError(f"{damaged} (checksum)")
        self._unpacked = (offset, records)
        return records

    def _scan(self) -> None:
        """Find all records of the data section."""
        offset, size = len(MAGIC), len(self._map)
        while offset + _HEAD.size <= size:
            opcode, length = _HEAD.unpack_from(self._map, offset)
            start, end = offset + _HEAD.size, offset + _HEAD.size + length
            if opcode not in _KNOWN:  # not a record: a hole, as a crash of the whole machine can leave
                return
            if opcode == _CHUNK:
                # A chunk that is incomplete or cannot be unpacked loses only its own messages.
                try:
                    self._scan_chunk(start, min(end, size))
                except _DamageError as error:
                    self.problems.append(str(error))
                except struct.error:
                    pass
                if end > size:
                    return
            elif end > size:
                return
            elif opcode == _DATA_END:
                self.complete = bytes(self._map[-len(MAGIC) :]) == MAGIC
                self.sound_end = offset
                return
            elif opcode == _MESSAGE:
                self._message(self._map, start, end, -1)
            else:
                self._definition(opcode, bytes(self._map[start:end]))
            offset = self.sound_end = end

    def _scan_chunk(self, chunk: int, end: int) -> None:
        """Find the records in a chunk; in an uncompressed chunk that was cut off, those before the cut."""
        compression, first, last, *_ = self._chunk(chunk)
        if compression and last > end:
            return
        records = self._unpack(chunk) if compression else self._map
        offset, end = (0, len(records)) if compression else (first, min(last, end))
        base = 0 if compression else first
        while offset + _HEAD.size <= end:
            opcode, length = _HEAD.unpack_from(records, offset)
            start, stop = offset + _HEAD.size, offset + _HEAD.size + length
            if stop > end or opcode not in _KNOWN:
                return
            if opcode == _MESSAGE:
                self._message(records, start, stop, chunk, base)
            else:
                self._definition(opcode, bytes(records[start:stop]))
            offset = stop

    def _message(self, records: bytes | mmap.mmap, start: int, end: int, chunk: int, base: int = 0) -> None:
        if end - start < _MESSAGE_HEAD.size:
            return
        channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(records, start)
        if channel in self.channels:
            self.messages.append(Message(channel, log_time_ns, chunk, start + _MESSAGE_HEAD.size - base, end - base))

    def _definition(self, opcode: int, content: bytes) -> None:
        fields = _Fields(content)
        try:
            if opcode == _SCHEMA:
                number, name, encoding = fields.number("<H"), fields.text(), fields.text()
                self._schemas[number] = (name, encoding, fields.blob())
            elif opcode == _CHANNEL:
                number, schema = fields.number("<H"), fields.number("<H")
                topic, encoding, metadata = fields.text(), fields.text(), fields.texts()
                name, schema_encoding, data = self._schemas.get(schema, ("", "", b""))
                self.channels[number] = Channel(number, topic, encoding, metadata, name, schema_encoding, data)
            elif opcode == _METADATA:
                name = fields.text()
                self.metadata[name] = fields.texts()
        except struct.error:
            self.problems.append(f"{self.path} is damaged: one of its definitions cannot be read")


class _Fields:
    """Reads the fields of a record, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def number(self, form: str) -> int:
        (value,) = struct.unpack_from(form, self._content, self._at)
        self._at += struct.calcsize(form)
        return value

    def blob(self) -> bytes:
        length = self.number("<I")
        self._at += length
        if self._at > len(self._content):
            raise struct.error("a field is longer than its record")
        return self._content[self._at - length : self._at]

    def text(self) -> str:
        return self.blob().decode("utf-8", "replace")

    def texts(self) -> dict[str, str]:
        fields, entries = _Fields(self.blob()), {}
        while fields._at < len(fields._content):
            key = fields.text()
            entries[key] = fields.text()
        return entries


def iterate_topics(file: McapFile) -> Iterator[tuple[Channel, list[Message]]]:
    """Each channel with its messages."""
    by_channel: dict[int, list[Message]] = {number: [] for number in file.channels}
    for message in file.messages:
        by_channel[message.channel].append(message)
    return ((file.channels[number], messages) for number, messages in by_channel.items())
