"""Results and dives in the formats that others read: TUM, KITTI, EuRoC, MCAP, GeoJSON, KML, CSV."""

from uwgraph.export.formats import FORMATS, Exported, FormatName, export, guess_format
from uwgraph.export.result import is_result, read_result
from uwgraph.export.source import Source, source_of_dive
from uwgraph.export.track import Track, track_of_reference, track_of_solution

__all__ = [
    "FORMATS",
    "Exported",
    "FormatName",
    "Source",
    "Track",
    "export",
    "guess_format",
    "is_result",
    "read_result",
    "source_of_dive",
    "track_of_reference",
    "track_of_solution",
]
