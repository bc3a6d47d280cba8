"""What the tests work on: the logs of this repository, and the binary of the wheel that is installed."""

from pathlib import Path

import pytest

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture
def faulty() -> Path:
    """A UR5e whose controller pose is 15 ms late, and whose elbow is 0.6° off."""
    return FIXTURES / "faulty.mcap"


@pytest.fixture
def clean() -> Path:
    """The same arm with nothing wrong."""
    return FIXTURES / "clean.mcap"
