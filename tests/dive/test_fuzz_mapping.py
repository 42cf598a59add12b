"""Mutated mapping files, for a sound log."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fuzzing import survives
from test_fuzz_csv import tables

from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.dive.yamlfile import read_settings
from uwgraph.errors import ConfigError
from uwgraph.types import Origin


def test_mutated_mappings(tmp_path: Path) -> None:
    log, dive = tmp_path / "log", tmp_path / "dive"
    log.mkdir()
    for name, content in tables().items():
        (log / name).write_bytes(content)
    wishes = Wishes(origin=Origin(0.7, 0.1))
    import_dive(log, dive, "csv", options=LogOptions(wishes=wishes))
    mapping = (dive / "mapping.yaml").read_bytes()

    def call(folder: Path) -> None:
        shutil.rmtree(dive, ignore_errors=True)
        options = LogOptions(mapping=read_settings(LogMapping, folder / "mapping.yaml"), wishes=wishes)
        import_dive(log, dive, "csv", options=options)

    tally = survives(call, {"mapping.yaml": mapping}, tmp_path)
    print(tally)
    assert tally.imported > 0
    assert tally.refused > 0


@pytest.mark.parametrize(
    "text",
    [
        "streams: !!python/object/apply:os.system ['true']\n",
        "a: &a [x, x]\nb: [*a, *a]\n",
        "streams: {imu: {topic: t, f: [" + "[" * 5000 + "\n",
        "images: {../../etc: {topic: t}}\n",
        "images: {/tmp/x: {topic: t}}\n",
        "images: {.hidden: {topic: t}}\n",
        "x" * (2 << 20),
        "streams: {depth: {topic: t, depth: 'a" + ".a" * 10_000 + "'}}\nstrems: 1\n",
    ],
)
def test_hostile_mappings(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"m\.yaml"):
        read_settings(LogMapping, tmp_path / "m.yaml")
