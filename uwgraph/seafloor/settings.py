"""What a map is made with."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from uwgraph.camera.refraction import refractive_index
from uwgraph.dive.rig import Positive, Settings


class MapSettings(Settings):
    """Settings of :func:`uwgraph.seafloor.make_map`."""

    voxel_m: Positive | None = None
    """Size of a cell of the fused cloud; None: a hundredth of the median distance to the floor."""
    pixel_m: Positive | None = None
    """Size of a pixel of the picture from above; None: what a pixel of the images covers."""
    n: Annotated[float, Field(ge=1.0, le=2.0)] = round(refractive_index(), 4)
    """Refractive index of what lies before a flat port: 1 in air."""
    keyframe_step: Annotated[float, Field(gt=0.0, le=2.0)] = 0.2
    """Images closer than this to the last keyframe are left out, in parts of the distance to the floor."""
    nearest: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.4
    """Points nearer than this are no floor, in parts of the usual altitude."""
    farthest: Annotated[float, Field(gt=1.0, le=20.0)] = 2.0
    """Points farther than this are not kept, in parts of the usual altitude (its upper quartile)."""
    slope_sigma: Positive = 0.1
    """1-sigma of the floor's slope across the track, which one echo sounder does not tell (metres per metre)."""
    disparity_sigma: Positive = 0.03
    """Pixels; what the disparities of a stereo pair err by whatever the texture."""
    texture_pixels: Annotated[int, Field(ge=10_000, le=20_000_000)] = 1_000_000
    """Larger images are reduced to about so many pixels."""
    max_pixels: Annotated[int, Field(ge=10_000, le=200_000_000)] = 25_000_000
    """The picture from above has at most so many pixels: its pixels grow where it would have more."""
