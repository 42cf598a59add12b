"""The sun as a heading reference."""

from uwgraph.sun.ephemeris import sun_azimuth_elevation, sun_direction_n

__all__ = ["sun_azimuth_elevation", "sun_direction_n"]
