"""The depth benchmark's situations and its summary."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def sun_depth(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("sun_depth")


def test_a_scene_is_the_same_at_all_depths_and_in_all_waters(sun_depth):
    one, other = sun_depth.Situation.draw("coastal", 2.0, 3), sun_depth.Situation.draw("clear", 20.0, 3)
    for name in ("rph", "s_l", "tilt_known"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.scene.wind_from_deg == other.scene.wind_from_deg
    assert not np.allclose(one.rph, sun_depth.Situation.draw("coastal", 2.0, 4).rph)


@pytest.mark.slow
def test_all_methods_find_the_heading_near_the_surface(sun_depth):
    found = sun_depth.headings("clear", 2.0, 0)
    assert len({h.method for h in found}) == len(found) == 11
    assert max(abs(h.error) for h in found) < np.radians(5.0)
    rows = [sun_depth.summary("clear", 2.0, h.method, [h]) for h in found]
    assert all(
        row["rmse_all_deg"] == pytest.approx(np.degrees(abs(h.error))) for row, h in zip(rows, found, strict=True)
    )


def test_refused_images_do_not_count(sun_depth):
    good, bad = sun_depth.Heading("m", 0.01, ()), sun_depth.Heading("m", 1.0, ("dark",))
    lost = sun_depth.Heading("m", np.nan, ("dark",))
    row = sun_depth.summary("clear", 2.0, "m", [good, bad, lost, good])
    assert row["refused"] == 0.5
    assert row["rmse_deg"] == pytest.approx(np.degrees(0.01))
    assert row["median_all_deg"] == pytest.approx(np.degrees(0.01))
    assert row["rmse_all_deg"] == pytest.approx(np.degrees(np.sqrt((1.0 + 2e-4) / 3)))
    assert np.isnan(sun_depth.summary("clear", 2.0, "m", [lost])["rmse_deg"])
