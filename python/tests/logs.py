"""Logs for tests, made of the ones that are kept."""

from pathlib import Path

_LIBRARY = b"poseaudit"
_DATA_END = b"\x0f\x04\0\0\0\0\0\0\0"


def distinct(log: Path, number: int, place: Path) -> Path:
    """A copy of an MCAP file that says the same and has other bytes: who wrote it is a number."""
    bytes_of = log.read_bytes()
    assert bytes_of.count(_DATA_END) == 1
    end = bytes_of.index(_DATA_END) + len(_DATA_END)
    # The checksum over all of it goes with the old name: 0 says that there is none.
    whole = bytes_of[:end] + bytes(4) + bytes_of[end + 4 :]
    place.write_bytes(whole.replace(_LIBRARY, b"%09d" % number, 1))
    return place
