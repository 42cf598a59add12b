"""Cameras: calibration files, pixels and rays, image files."""
