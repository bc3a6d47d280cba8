"""Logs for tests, derived from the fixtures."""

from pathlib import Path

_LIBRARY = b"poseaudit"
_DATA_END = b"\x0f\x04\0\0\0\0\0\0\0"


def distinct(log: Path, number: int, place: Path) -> Path:
    """A copy of an MCAP file with the same content but different bytes: a number as library name."""
    bytes_of = log.read_bytes()
    assert bytes_of.count(_DATA_END) == 1
    end = bytes_of.index(_DATA_END) + len(_DATA_END)
    # The data checksum is no longer valid: 0 means that there is none.
    whole = bytes_of[:end] + bytes(4) + bytes_of[end + 4 :]
    place.write_bytes(whole.replace(_LIBRARY, b"%09d" % number, 1))
    return place
