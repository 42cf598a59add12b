"""A bad ``dive.yaml``: every fault names the file, the key and the nearest known one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.yamlfile import MAX_BYTES
from uwgraph.errors import ConfigError
from uwgraph.types import Depth, Heading, Origin

T = 1_654_646_400_000_000_000 + np.arange(3)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    dive = Dive(
        Origin(0.57, 0.61),
        depth=Depth(T, np.ones(3), np.ones(3)),
        heading=Heading(T, np.ones(3), np.ones(3)),
        provenance={"source": "made up"},
    )
    write_dive(dive, tmp_path / "dive")
    return tmp_path / "dive"


def refused(folder: Path, *words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_dive(folder)
    assert str(folder / "dive.yaml") in caught.value.where
    assert caught.value.remedy
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gyro_noise_density", "gyro_noise_densty", ("rig.imu.gyro_noise_densty", "did you mean 'gyro_noise_density'")),
        ("  dvl:", "  dlv:", ("rig.dlv", "did you mean 'dvl'")),
        ("provenance", "provenence", ("provenence", "did you mean 'provenance'")),
        ("gyro_noise_density: ", "gyro_noise_density: -", ("rig.imu.gyro_noise_density", "greater than 0")),
        ("gyro_noise_density: ", "gyro_noise_density: .nan #", ("rig.imu.gyro_noise_density",)),
        ("lat_deg: 32", "lat_deg: 132", ("origin.lat_deg", "90")),
        ("lat_deg: ", "lat_deg: north", ("origin.lat_deg", "'north")),
        ("lat_deg", "lat", ("origin.lat",)),
        ("depth, heading", "depth, sonar", ("streams.1", "'sonar'")),
        ("depth, heading", "depth, images/../../etc", ("streams.1",)),
        ("depth, heading", "depth, depth", ("'depth' is listed twice",)),
        ("origin:", "origin: [", ("line ",)),
        ("origin:", "origin: {}\norigin:", ("'origin' appears twice",)),
        ("origin:", "origin: *ref #", ("aliases",)),
        ("origin:", "origin: !!python/object/apply:os.getcwd [] #", ("line 1",)),
        ("origin:", "\x00", ("YAML",)),
        ("origin:", "[" * 3000, ("YAML",)),
    ],
)
def test_bad_settings(folder: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    yaml = folder / "dive.yaml"
    assert old in yaml.read_text()
    yaml.write_text(yaml.read_text().replace(old, new, 1))
    refused(folder, *words)


@pytest.mark.parametrize("content", [b"", b"just words", b"[1, 2]", b"\xff\xfe\xff", b"#" * (MAX_BYTES + 1), b"1: 2"])
def test_settings_that_are_something_else(folder: Path, content: bytes) -> None:
    (folder / "dive.yaml").write_bytes(content)
    refused(folder)
