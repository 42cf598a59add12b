"""A small textured floor, and dives over it; made importable by the tests beside it."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from floor_scene import Scene, dive_over


@pytest.fixture(scope="session")
def stereo_scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Two laps over a wavy floor with a stereo pair and an echo sounder."""
    return dive_over(tmp_path_factory.mktemp("stereo") / "dive", stereo=True)


@pytest.fixture(scope="session")
def mono_scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The same with one camera."""
    return dive_over(tmp_path_factory.mktemp("mono") / "dive", stereo=False)
