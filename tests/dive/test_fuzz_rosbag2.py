"""Mutated ROS 2 bags: their metadata and their files, of both storages, compressed and not."""

from __future__ import annotations

from pathlib import Path

from fuzzing import survives
from roslogs import write_rosbag2

from uwgraph.dive.importing import read_recording

BAGS = {"plain": ("sqlite3", ""), "file": ("sqlite3", "file"), "message": ("sqlite3", "message"), "mcap": ("mcap", "")}


def test_mutated_bags_are_imported_or_refused_in_words(tmp_path: Path) -> None:
    files = {
        str(file.relative_to(tmp_path)): file.read_bytes()
        for name, (storage, compression) in BAGS.items()
        for file in write_rosbag2(tmp_path / name, storage, compression=compression, seconds=2).iterdir()
    }

    def import_mutated(folder: Path) -> None:
        changed = {name.partition("/")[0] for name, sound in files.items() if (folder / name).read_bytes() != sound}
        for bag in changed:
            read_recording(folder / bag, "rosbag", images_into=tmp_path / "images")

    tally = survives(import_mutated, files, tmp_path)
    print(tally)
    assert tally.imported
    assert tally.refused
