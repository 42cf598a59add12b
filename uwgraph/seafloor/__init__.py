"""The map of the sea floor: points and mosaics from a dive's images along its solution."""

from uwgraph.seafloor.make import deform_map, make_map
from uwgraph.seafloor.settings import MapSettings

__all__ = ["MapSettings", "deform_map", "make_map"]
