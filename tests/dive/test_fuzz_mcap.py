"""Mutated MCAP files of all encodings, chunked and not."""

from __future__ import annotations

from pathlib import Path

from fuzzing import survives
from roslogs import write_mcap

from uwgraph.dive.importing import read_recording

FILES = {
    "plain.mcap": ("cdr", "NONE", False),
    "lz4.mcap": ("cdr", "LZ4", True),
    "zstd.mcap": ("ros1", "ZSTD", True),
    "json.mcap": ("json", "NONE", True),
}


def test_mutated_files_are_imported_or_refused_in_words(tmp_path: Path) -> None:
    files = {}
    for name, (encoding, compression, chunked) in FILES.items():
        file = write_mcap(tmp_path / name, encoding, compression, seconds=2, use_chunking=chunked)
        files[name] = file.read_bytes()

    def import_mutated(folder: Path) -> None:
        for name, sound in files.items():
            if (folder / name).read_bytes() != sound:
                read_recording(folder / name, "mcap", images_into=tmp_path / "images")

    tally = survives(import_mutated, files, tmp_path)
    print(tally)
    assert tally.imported
    assert tally.refused
