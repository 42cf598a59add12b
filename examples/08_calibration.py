"""A DVL that was bolted on somehow: its scale, mounting, lever arm and clock are found from one dive with fixes.

    python examples/08_calibration.py [seconds]

The dive is simulated: short legs in a current, a DVL that reads 1 % and 1 degree off and stamps 0.2 s late, satellite
fixes before and after. On the command line: ``uwgraph calibrate dvl DIVE -o rig.yaml``, then ``uwgraph calibrate apply
rig.yaml OTHER_DIVE``.
"""

from __future__ import annotations

import sys
from dataclasses import replace

from uwgraph.calibrate import calibrate_dives
from uwgraph.calibrate.report import figure
from uwgraph.dive.rig import DvlRig
from uwgraph.dive.rigfile import apply_rig
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import DvlModel, SimulationSettings, simulate

LATE_S = 0.2

if __name__ == "__main__":
    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 1200.0
    true = DvlRig(translation_m=(0.4, 0.1, 0.15), time_offset_s=-LATE_S, scale_sigma=0.01, misalignment_sigma_deg=1.0)
    settings = SimulationSettings(
        duration_s=duration,
        leg_length_m=120.0,
        current=(0.35, -0.3),
        waves=1.5,
        surface_at_end=True,
        dvl=DvlModel(rig=true),
    )
    dive = simulate(settings, seed=3)
    drawn = dive.provenance["drawn"]
    bare = replace(dive, rig=dive.rig.model_copy(update={"dvl": DvlRig()}))

    found = calibrate_dives([bare], "dvl")
    truth = {"dvl.scale": 1.0 + drawn["dvl_scale"], "dvl.time_offset_s": -LATE_S}
    truth |= {f"dvl.translation_m.{axis}": value for axis, value in zip("xyz", true.translation_m, strict=True)}
    for e in found.estimates:
        told = f"{figure(e.after, e.sigma)} +- {e.sigma:.2g} {e.unit}" if e.observable else "not told by this motion"
        print(f"{e.name:26} {told}" + (f" (true {truth[e.name]:.4f})" if e.name in truth else ""))
    print(*(f"  - {statement.text}" for statement in found.unseen), sep="\n")

    for name, one in (("bare rig", bare), ("calibrated", apply_rig(bare, found.rig, keep_clocks=False))):
        errors = judge(one, smooth(one, SmoothSettings())).metrics
        print(f"{name:10} horizontal RMSE {errors['horizontal_rmse_m']:.2f} m")
