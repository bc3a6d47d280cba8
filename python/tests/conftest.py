"""Fixtures: the logs of this repository, and the binary of the installed wheel."""

from pathlib import Path

import pytest

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture
def faulty() -> Path:
    """A UR5e with a controller pose that is 15 ms late, and a zero offset of 0.6° at the elbow."""
    return FIXTURES / "faulty.mcap"


@pytest.fixture
def clean() -> Path:
    """The same arm without faults."""
    return FIXTURES / "clean.mcap"
