"""Logs for tests, derived from the fixtures."""

from pathlib import Path

_LIBRARY = b"poseaudit"
_DATA_END = b"\x0f\x04\0\0\0\0\0\0\0"


def copy_with_other_bytes(log: Path, number: int, place: Path) -> Path:
    """A copy of an MCAP file with the same content but different bytes: a number as library name."""
    content = log.read_bytes()
    assert content.count(_DATA_END) == 1
    end = content.index(_DATA_END) + len(_DATA_END)
    # The data checksum is no longer valid: 0 means that there is none.
    changed = content[:end] + bytes(4) + content[end + 4 :]
    place.write_bytes(changed.replace(_LIBRARY, b"%09d" % number, 1))
    return place
