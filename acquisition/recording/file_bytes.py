"""A file's bytes by their place: read and written without a shared position, and shown to HDF5 such that no failure
of the disk reaches it.

HDF5 cannot let go of a file that it cannot write (it crashes at the end of the process), and two of its handles on one
file upset each other. So it only ever lays a file out or says where things are; samples pass it by.
"""

import errno
import os
import struct

READ_TRIES = 3
"""Some disks give at the second time what they refused at the first."""
_SUPERBLOCK = struct.Struct("<8sBBBBQQQQ")  # format 3: signature, version, sizes, flags, base, extension, end, root


def read_at(fd: int, size: int, place: int) -> bytes:
    """Up to `size` bytes from `place` on, fewer at the file's end. Raises `OSError` where the disk gives nothing."""
    parts: list[bytes] = []
    while size > 0:
        part = _read_some(fd, size, place)
        if not part:
            break
        parts.append(part)
        size, place = size - len(part), place + len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def write_at(fd: int, data: bytes | memoryview, place: int) -> None:
    """All of `data` at `place`. Raises `OSError`; then part of it may be there."""
    view = memoryview(data).cast("B")
    while len(view):
        if hasattr(os, "pwrite"):
            done = os.pwrite(fd, view, place)
        else:  # Windows
            os.lseek(fd, place, os.SEEK_SET)
            done = os.write(fd, view)
        if done == 0:
            raise OSError(errno.EIO, "the disk took nothing")
        view, place = view[done:], place + done


def _read_some(fd: int, size: int, place: int) -> bytes:
    for tries_left in range(READ_TRIES - 1, -1, -1):
        try:
            if hasattr(os, "pread"):
                return os.pread(fd, size, place)
            os.lseek(fd, place, os.SEEK_SET)  # Windows
            return os.read(fd, size)
        except OSError:
            if not tries_left:
                raise
    raise AssertionError


class HdfBytes:
    """What h5py takes for a file: the bytes of `fd`. HDF5 itself never meets an error: a read that fails gives zeros,
    and so do all after it (on zeros among the file's own bytes HDF5 crashes); writes after the first that failed go
    nowhere; `failure` says so.

    A mark that a writer has it open, left by a crash, and an end beyond the file's own, as an incomplete copy has
    it, are no obstacles.
    """

    def __init__(self, fd: int, name: str) -> None:
        """`name`: what the file is called in messages."""
        self._fd, self._name, self._at = fd, name, 0
        self.failure: OSError | None = None
        self._blind = False
        self._start, self._end = self._superblock()

    def __repr__(self) -> str:
        """What h5py takes for the file's name."""
        return self._name

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: max(os.fstat(self._fd).st_size, self._end)}
        self._at = base[whence] + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int) -> bytes:
        """By this h5py tells files from names; it reads by `readinto`."""
        data = bytearray(size)
        self.readinto(memoryview(data))
        return bytes(data)

    def readinto(self, buffer: memoryview) -> int:
        size, at = len(buffer), self._at
        data = self._read(size, at)
        if at < len(self._start) and not self._blind:
            head = self._start[at : at + size]
            data = head + data[len(head) :]
        buffer = memoryview(buffer)  # that of h5py before 3.12 takes no bytes
        buffer[: len(data)] = data
        buffer[len(data) :] = bytes(size - len(data))
        self._at += size
        return size

    def write(self, data: bytes | memoryview) -> int:
        size = len(memoryview(data).cast("B"))
        if self.failure is None:
            try:
                write_at(self._fd, data, self._at)
            except OSError as error:
                self.failure = error
        self._at += size
        return size

    def truncate(self, size: int | None = None) -> int:
        size = self._at if size is None else size
        if self.failure is None:
            try:
                os.ftruncate(self._fd, size)
            except OSError as error:
                self.failure = error
        return size

    def flush(self) -> None:
        """Nothing is kept back here."""

    def _read(self, size: int, at: int) -> bytes:
        if not self._blind:
            try:
                return read_at(self._fd, size, at)
            except OSError as error:
                self.failure, self._blind = self.failure or error, True
        return b""

    def _superblock(self) -> tuple[bytes, int]:
        """The first bytes as they are without a writer's mark (empty: as they are), and the end that they state."""
        raw = self._read(_SUPERBLOCK.size + 4, 0)
        if len(raw) < _SUPERBLOCK.size + 4 or raw[:9] != b"\x89HDF\r\n\x1a\n\x03" or raw[9:11] != b"\x08\x08":
            return b"", 0
        plain, (checksum,) = raw[: _SUPERBLOCK.size], struct.unpack("<I", raw[_SUPERBLOCK.size :])
        if lookup3(plain) != checksum:
            return b"", 0
        end = min(_SUPERBLOCK.unpack(plain)[7], 1 << 62)
        unmarked = plain[:11] + b"\0" + plain[12:]
        return unmarked + struct.pack("<I", lookup3(unmarked)), end


def lookup3(data: bytes) -> int:
    """Bob Jenkins' 32-bit hash `lookup3` with initial value 0: HDF5's checksum of metadata (HDF5 File Format
    Specification 3.0, "Checksum")."""

    def rotated(value: int, by: int) -> int:
        return (value << by | value >> 32 - by) & 0xFFFFFFFF

    a = b = c = (0xDEADBEEF + len(data)) & 0xFFFFFFFF
    words = struct.unpack(f"<{-(-len(data) // 12) * 3}I", data + bytes(-len(data) % 12))
    for first in range(0, len(words), 3):
        a, b, c = (value + word & 0xFFFFFFFF for value, word in zip((a, b, c), words[first : first + 3], strict=True))
        if first + 3 < len(words):
            for by in (4, 6, 8, 16, 19, 4):
                a = (a - c ^ rotated(c, by)) & 0xFFFFFFFF
                c = c + b & 0xFFFFFFFF
                a, b, c = b, c, a
    for by in (14, 11, 25, 16, 4, 14, 24):
        c = (c ^ b) - rotated(b, by) & 0xFFFFFFFF
        a, b, c = b, c, a
    return b  # the turn after the last step has moved the result here
