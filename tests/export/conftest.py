"""The hand-made dive of tests/evaluate, and a short simulated one."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "evaluate"))

from uwgraph.dive.model import Dive
from uwgraph.simulate import SimulationSettings, simulate


@pytest.fixture(scope="session")
def short_dive() -> Dive:
    """Half a minute with every sensor and the truth as reference."""
    return simulate(SimulationSettings(duration_s=30.0, grade="mems"), seed=2)
