"""``uwgraph calibrate import``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwgraph.cli.console import note, print_json, print_table, refuse_existing
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.camera.calibration_files import Calibrations
    from uwgraph.dive.rig import Rig

EXAMPLES = """Examples:

[bold]uwgraph calibrate import imu.yaml -o rig.yaml[/bold]

[bold]uwgraph calibrate import camchain-imucam.yaml imu.yaml -o rig.yaml --camera-out camera.yaml --imu-axes flu[/bold]

[bold]uwgraph calibrate import opencv.xml --camera-out dives/run1/images/up/camera.yaml[/bold]"""


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES...", help="Kalibr's or allan_variance_ros's imu.yaml, camchain.yaml, OpenCV's YAML or XML."
        ),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="RIG.yaml", help="The rig file to write.")] = None,
    camera_out: Annotated[
        Path | None, typer.Option(metavar="CAMERA.yaml", help="The camera file to write, ours.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(metavar="RIG.yaml", help="The rig that everything else is taken from.")
    ] = None,
    imu: Annotated[str | None, typer.Option(metavar="NAME", help="Which IMU, of several: imu0 is the default.")] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which camera, of several: cam0 is the default.")
    ] = None,
    imu_axes: Annotated[
        str | None,
        typer.Option(
            metavar="XYZ",
            help="Where the IMU's x, y and z point in the vehicle: frd (forward, right, down), flu, bru, ...",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are already there.")] = False,
) -> None:
    """Take calibrations over: IMU noise into a rig file, a camera with its mounting and clock into a camera file."""
    from uwgraph.atomic import atomic_file
    from uwgraph.camera.calibration_files import read_calibrations
    from uwgraph.camera.file import write_camera
    from uwgraph.dive.rig import Rig
    from uwgraph.dive.rigfile import read_rig, write_rig

    for target in (out, camera_out):
        refuse_existing(target, force)
    found = read_calibrations(files, imu, camera)
    before = Rig() if rig is None else read_rig(rig)
    after = found.rig(before)
    if camera_out is not None:
        if (mounted := found.mounted_camera(imu_axes)) is None:
            raise ConfigError("none of the files holds a camera", where="--camera-out", remedy="give its calibration")
        with atomic_file(camera_out) as partial:
            write_camera(partial, mounted)
        note(f"camera in {camera_out}")
    if out is not None:
        write_rig(after, out, (f"from {', '.join(file.name for file in files)}",))
        note(f"rig in {out}")
    if as_json:
        print_json({"rig": after.model_dump(mode="json"), "changed": _changes(before, after), "notes": _notes(found)})
    else:
        print_table(
            "rig", ("field", "value"), [(name, f"{value:.6g}") for name, value in _changes(before, after).items()]
        )
        print("\n".join(f"  - {line}" for line in _notes(found)))


def _changes(before: Rig, after: Rig) -> dict[str, float]:
    """What the calibrations say of the rig, where it differs from before."""
    return {
        f"{sensor}.{field}": value
        for sensor in ("imu", "sun")
        for field, value in getattr(after, sensor).model_dump().items()
        if value != getattr(getattr(before, sensor), field)
    }


def _notes(found: Calibrations) -> list[str]:
    lines = []
    if found.imu is not None:
        lines.append(
            f"IMU noise of {found.imu_name}; scale and misalignment matrices, if any, are not applied to samples"
        )
    if found.camera is not None:
        size = "x".join(map(str, found.camera.camera.size))
        lines.append(f"a {found.camera.camera.model} camera of {size} pixels")
        lines.append(
            "how it sits in the vehicle is not stated: mount up-forward is assumed"
            if found.on_imu is None
            else "its mounting is told against the IMU: --camera-out writes R_bs; its place does not matter to the sun"
        )
        if found.on_imu is not None and found.on_imu.time_offset_s is not None:
            lines.append("its clock offset went to the rig's sun.time_offset_s")
    return lines
