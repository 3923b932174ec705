"""What is closed by a `with` block is closed however the block ends."""

import pytest

from svmdist.simulation.bullet import Closing


class Counting(Closing):
    """Counts how often it was closed."""

    count = 0

    def close(self) -> None:
        """Count."""
        self.count += 1


def test_a_block_closes_once():
    with Counting() as held:
        assert held.count == 0
    assert held.count == 1


def test_a_block_that_fails_closes_and_raises():
    held = Counting()
    with pytest.raises(ValueError, match="inside"), held:
        raise ValueError("inside")
    assert held.count == 1
