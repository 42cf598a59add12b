"""uwgraph: factor-graph navigation for underwater vehicles, with the sun as the heading reference.

Conventions
-----------
Navigation frame **n**: Cartesian NED, tangent to the WGS-84 ellipsoid at the dive's origin on the surface. It is exact,
not a flat Earth: depth is measured along the local vertical, gravity is that of the place, reported heading is against
local true north.

Body frame **b**: forward, right, down (FRD), origin at the IMU. A resting FRD accelerometer reads (0, 0, -g).

Names carry frames: ``R_nb`` rotates body to navigation, ``v_n`` is a velocity in navigation axes, ``w_b`` an angular
rate in body axes, ``l_b`` a lever arm in the body, ``R_bs`` a sensor's mounting. SI units and radians everywhere;
degrees only in files and on the command line, with ``_deg`` in the name. Time is int64 nanoseconds UTC.

An IMU sample with stamp t_i is the mean over (t_{i-1}, t_i]. Noise is given as density (per sqrt(Hz)). Tangent and
covariance order of a pose is GTSAM's: rotation, then translation, both in the body frame; what people read (files,
tables) is north, east, down and roll, pitch, heading. NEES and NIS are divided by their degrees of freedom, so that
their expectation is 1. Headings are clockwise from north and say whether they are ``true`` or ``magnetic``.
"""

__version__ = "0.1.0"
