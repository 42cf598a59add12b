from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from uwgraph.chi_square import chi2_beyond, chi2_quantile


@given(st.floats(1e-6, 1.0 - 1e-9), st.integers(1, 5000))
def test_quantiles_are_those_of_scipy(share: float, dof: int) -> None:
    assert chi2_quantile(share, dof) == pytest.approx(chi2.ppf(share, dof), rel=1e-10)


@given(st.floats(0.0, 1e4), st.integers(1, 5000))
def test_tails_are_those_of_scipy(value: float, dof: int) -> None:
    assert chi2_beyond(value, dof) == pytest.approx(chi2.sf(value, dof), rel=1e-9, abs=1e-300)


def test_arrays_are_broadcast() -> None:
    shares, dofs = np.array([[0.1], [0.9]]), np.array([1, 2, 3])
    np.testing.assert_allclose(chi2_quantile(shares, dofs), chi2.ppf(shares, dofs), rtol=1e-12)


def test_what_is_slow_to_load_waits_until_it_is_needed() -> None:
    """Every command and every process of a comparison pays for what ``uwgraph.graph`` loads."""
    slow = "pandas", "pvlib", "scipy.stats", "sklearn", "matplotlib", "open3d"
    script = f"import sys, uwgraph.graph; print([name for name in {slow} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
