"""Real ROS 1 bags: a sky compass on a turning robot, with a wrong clock in its headers."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.types import Origin

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
BAGS = sorted((DATA / "sky_compass").glob("*.bag"))

pytestmark = [pytest.mark.data, pytest.mark.skipif(not BAGS, reason=f"no sky compass bags in {DATA}")]

YAW = LogMapping.model_validate(
    {
        "origin": {"lat_deg": 39.258648, "lon_deg": 8.440184},
        "streams": {"heading": {"topic": "yaw", "heading": "data", "world": "enu", "reference": "true"}},
    }
)


@pytest.mark.parametrize("bag", BAGS, ids=lambda bag: bag.stem)
def test_a_bag_with_a_mapping(bag: Path, tmp_path: Path) -> None:
    report = import_dive(bag, tmp_path / "dive", options=LogOptions(mapping=YAW))
    heading = read_dive(tmp_path / "dive").heading
    assert heading is not None
    assert 400 < len(heading) < 430
    turned = np.unwrap(heading.heading)
    assert abs(abs(turned[-1] - turned[0]) - 2 * np.pi) < 0.2
    left = {topic.topic for topic in report.left}
    assert {f"pol_op_{unit}" for unit in range(8)} <= left


def test_without_a_mapping_the_odometry_is_the_reference(tmp_path: Path) -> None:
    wishes = Wishes(origin=Origin(np.radians(39.258648), np.radians(8.440184)))
    report = import_dive(BAGS[0], tmp_path / "dive", options=LogOptions(wishes=wishes))
    reference = read_dive(tmp_path / "dive").reference
    assert reference is not None
    assert len(reference) > 400
    assert any("days off the log" in caveat for caveat in report.caveats), report.caveats
    assert any("images" in caveat for caveat in report.caveats), report.caveats
