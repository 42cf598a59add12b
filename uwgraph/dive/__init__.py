"""The dive on disk and in memory."""

from uwgraph.dive.model import STREAM_TYPES, Dive
from uwgraph.dive.rig import Rig

__all__ = ["STREAM_TYPES", "Dive", "Rig"]
