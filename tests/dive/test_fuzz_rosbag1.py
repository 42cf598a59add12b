"""Mutated ROS 1 bags."""

from __future__ import annotations

from pathlib import Path

from fuzzing import survives
from roslogs import write_rosbag1

from uwgraph.dive.importing import read_recording


def test_mutated_bags_are_imported_or_refused_in_words(tmp_path: Path) -> None:
    names = {f"{compression or 'none'}.bag": compression for compression in ("", "BZ2", "LZ4")}
    files = {name: write_rosbag1(tmp_path / name, names[name], seconds=2).read_bytes() for name in names}

    def import_mutated(folder: Path) -> None:
        for name, sound in files.items():
            if (folder / name).read_bytes() != sound:
                read_recording(folder / name, "rosbag", images_into=tmp_path / "images")

    tally = survives(import_mutated, files, tmp_path)
    print(tally)
    assert tally.imported
    assert tally.refused
