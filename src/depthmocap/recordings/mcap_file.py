"""MCAP files, read record by record from a memory map (specification: mcap.dev/spec).

The summary at the file's end is not needed: a file that was cut off at any byte gives every record before the cut,
those inside an unfinished chunk included. Chunks without compression are read where they lie.
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

#: Bytes that a chunk may unpack to.
LARGEST_CHUNK = 1 << 28
MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0C, 0x0F
_KNOWN = frozenset(range(0x01, 0x10))


class _DamageError(InputError):
    """A chunk that cannot be unpacked."""


@dataclasses.dataclass(frozen=True)
class Channel:
    """A channel, with its schema."""

    id: int
    topic: str
    encoding: str
    metadata: dict[str, str]
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclasses.dataclass(frozen=True)
class Message:
    """Where a message lies: its payload is ``data[start:end]`` of the chunk at ``chunk``, or of the file for -1."""

    channel: int
    log_time_ns: int
    chunk: int
    start: int
    end: int


class McapFile:
    """What a file holds, found in one pass; payloads are read as they are asked for. A context manager.

    Attributes:
        channels: by id.
        metadata: of the metadata records, by name.
        messages: in the order of the file.
        problems: what cannot be read besides messages, one line each.
        complete: whether the file was finished; otherwise it was cut off, or is being written.
        sound_end: the byte after the last whole record.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError when it cannot be read, or is not MCAP."""
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
        """The message's first bytes, not checked."""
        return self._bytes(message, message.start, min(message.end, message.start + length))

    def payload(self, message: Message) -> bytes:
        """The message's bytes.

        Raises:
            InputError: when its chunk does not have the checksum that was written.
        """
        if message.chunk >= 0 and message.chunk not in self._checked:
            compression, start, end, _, crc = self._chunk(message.chunk)
            # Of a chunk that was cut off only the length of its messages can be checked; unpacking checks by itself.
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

    def _chunk(self, at: int) -> tuple[str, int, int, int, int]:
        """Compression, first and last byte of the records, unpacked size and checksum of a chunk."""
        _, _, size, crc = _CHUNK_HEAD.unpack_from(self._map, at)
        at_name = at + _CHUNK_HEAD.size
        (length,) = struct.unpack_from("<I", self._map, at_name)
        compression = bytes(self._map[at_name + 4 : at_name + 4 + min(length, 16)]).decode("utf-8", "replace")
        at_size = at_name + 4 + length
        (stored,) = struct.unpack_from("<Q", self._map, at_size)
        return compression, at_size + 8, at_size + 8 + stored, size, crc

    def _unpack(self, at: int) -> bytes:
        if self._unpacked[0] == at:
            return self._unpacked[1]
        compression, start, end, size, crc = self._chunk(at)
        packed, damaged = self._map[start:end], f"{self.path}: the chunk at byte {start} is damaged"
        if size > LARGEST_CHUNK:
            raise _DamageError(f"{damaged}: it says that it unpacks to {size:,} bytes")
        try:
            # No more is unpacked than the chunk says, and a byte that tells that there would be more.
            if compression == "zstd":
                import zstandard

                with zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(packed) as stream:
                    records = stream.read(size + 1)
            elif compression == "lz4":
                import lz4.frame  # pyright: ignore[reportMissingTypeStubs]

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
        self._unpacked = (at, records)
        return records

    def _scan(self) -> None:
        """Find all records of the data section."""
        at, size = len(MAGIC), len(self._map)
        while at + _HEAD.size <= size:
            opcode, length = _HEAD.unpack_from(self._map, at)
            start, end = at + _HEAD.size, at + _HEAD.size + length
            if opcode not in _KNOWN:  # not a record: a hole, as a crash of the whole machine can leave
                return
            if opcode == _CHUNK:
                # One of which too little was written, or that cannot be unpacked, costs only its own messages.
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
                self.sound_end = at
                return
            elif opcode == _MESSAGE:
                self._message(self._map, start, end, -1)
            else:
                self._definition(opcode, bytes(self._map[start:end]))
            at = self.sound_end = end

    def _scan_chunk(self, at: int, end: int) -> None:
        """Find the records in a chunk; of an uncompressed one that is cut, those before the cut."""
        compression, first, last, *_ = self._chunk(at)
        if compression and last > end:
            return
        records = self._unpack(at) if compression else self._map
        offset, stop = (0, len(records)) if compression else (first, min(last, end))
        base = 0 if compression else first
        while offset + _HEAD.size <= stop:
            opcode, length = _HEAD.unpack_from(records, offset)
            begin, until = offset + _HEAD.size, offset + _HEAD.size + length
            if until > stop or opcode not in _KNOWN:
                return
            if opcode == _MESSAGE:
                self._message(records, begin, until, at, base)
            else:
                self._definition(opcode, bytes(records[begin:until]))
            offset = until

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
    """The fields of a record, one after the other."""

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
        fields, found = _Fields(self.blob()), {}
        while fields._at < len(fields._content):
            key = fields.text()
            found[key] = fields.text()
        return found


def iterate_topics(file: McapFile) -> Iterator[tuple[Channel, list[Message]]]:
    """Each channel with its messages."""
    by_channel: dict[int, list[Message]] = {number: [] for number in file.channels}
    for message in file.messages:
        by_channel[message.channel].append(message)
    return ((file.channels[number], messages) for number, messages in by_channel.items())
