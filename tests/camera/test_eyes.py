"""Which images of two cameras are of one moment."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.camera.eyes import together

PERIOD = 1_000_000_000


@given(st.sets(st.integers(0, 40), min_size=3), st.sets(st.integers(0, 40), min_size=3), st.integers(-40, 40))
def test_partners_are_those_of_one_moment(a, b, late_ms):
    """Whatever is missing on either side, and with a shutter that is late by less than a twentieth of the period."""
    left = np.array(sorted(a), dtype=np.int64) * PERIOD
    right = np.array(sorted(b), dtype=np.int64) * PERIOD + late_ms * 1_000_000
    rows, partners = together(left, right)
    assert (left[rows] // PERIOD).tolist() == sorted(a & b)
    np.testing.assert_array_equal(right[partners] - late_ms * 1_000_000, left[rows])


def test_single_images():
    assert [len(rows) for rows in together(np.array([5]), np.array([5]))] == [1, 1]
    assert [len(rows) for rows in together(np.array([5]), np.array([6]))] == [0, 0]
    assert [len(rows) for rows in together(np.array([5, 9]), np.array([9]))] == [1, 1]
