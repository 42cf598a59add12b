"""How much memory does the import of a large log take, and how long, against a plain read by the mcap library?

    python benchmarks/import_memory.py [--gigabytes 2] [--case mixed imu] [--json] [--save]

Writes an MCAP file of ROS 2 messages (chunks of 1 MiB, LZ4) into a temporary folder, imports it in a process of its
own, and deletes it. ``mixed`` is what a vehicle records: point clouds, images, a 200 Hz IMU, a DVL and a pressure
sensor; ``imu`` is the worst case, IMU messages alone (2 GB are 8 hours at 200 Hz): their stream has 56 bytes a sample,
which the dive must hold, so there the limit is one of bytes a message. Memory is the peak resident set of the importing
process, Python and its libraries (some 240 MB) included. Peer: the mcap library reading every message of the same file,
without decoding any.
"""

from __future__ import annotations

import resource
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from _bench import Figure, Row, finish, in_processes, parser, timed  # isort: skip
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.types import Origin

LIMIT_MB: Final = 500.0
START_NS: Final = 1_700_000_000_000_000_000
TYPES: Final = {
    "/imu": "sensor_msgs/msg/Imu",
    "/dvl": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "/pressure": "sensor_msgs/msg/FluidPressure",
    "/camera/image_raw": "sensor_msgs/msg/Image",
    "/sonar/points": "sensor_msgs/msg/PointCloud2",
}
RATES_HZ: Final = {
    "mixed": {"/imu": 200.0, "/dvl": 5.0, "/pressure": 10.0, "/camera/image_raw": 0.5, "/sonar/points": 4.0},
    "imu": {"/imu": 200.0},
}
POINTS: Final = 8000
IMAGE: Final = (480, 640)


def templates() -> dict[str, bytearray]:
    """One message of every topic as CDR; its stamp comes after the first four bytes."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, rng = store.types, np.random.default_rng(0)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    up = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 9.81)
    level = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    none = np.zeros(9)
    twist = types["geometry_msgs/msg/Twist"](zero, zero)
    noise = rng.integers(0, 256, IMAGE[0] * IMAGE[1], dtype=np.uint8)
    cloud = rng.integers(0, 256, 12 * POINTS, dtype=np.uint8)
    messages = {
        "/imu": types[TYPES["/imu"]](header, level, none, zero, none, up, none),
        "/dvl": types[TYPES["/dvl"]](
            header, types["geometry_msgs/msg/TwistWithCovariance"](twist, 1e-4 * np.eye(6).ravel())
        ),
        "/pressure": types[TYPES["/pressure"]](header, 150_000.0, 0.0),
        "/camera/image_raw": types[TYPES["/camera/image_raw"]](header, *IMAGE, "mono8", 0, IMAGE[1], noise),
        "/sonar/points": types[TYPES["/sonar/points"]](header, 1, POINTS, [], False, 12, 12 * POINTS, cloud, True),
    }
    return {topic: bytearray(store.serialize_cdr(message, TYPES[topic])) for topic, message in messages.items()}


def ticks(rates: dict[str, float]) -> Iterator[tuple[str, int]]:
    """Topics and stamps in the order of time, without end."""
    second = sorted((round(n / rate * 1e9), topic) for topic, rate in rates.items() for n in range(max(1, int(rate))))
    for start in range(10**9):
        for offset, topic in second:
            if rates[topic] >= 1.0 or start % round(1.0 / rates[topic]) == 0:
                yield topic, START_NS + start * 1_000_000_000 + offset


def write(path: Path, case: str, size: int) -> int:
    """A log of at least ``size`` bytes; how many messages it has."""
    store: Typestore = get_typestore(Stores.ROS2_HUMBLE)
    content, rates = templates(), RATES_HZ[case]
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4 if case == "mixed" else CompressionType.NONE)
        writer.start("ros2")
        links = {}
        for topic in rates:
            text = store.generate_msgdef(TYPES[topic], ros_version=2)[0].encode()
            links[topic] = writer.register_channel(topic, "cdr", writer.register_schema(TYPES[topic], "ros2msg", text))
        for count, (topic, t_ns) in enumerate(ticks(rates)):
            struct.pack_into("<iI", content[topic], 4, t_ns // 10**9, t_ns % 10**9)
            writer.add_message(links[topic], t_ns, bytes(content[topic]), t_ns)
            if count % 1024 == 0 and file.tell() >= size:
                break
        writer.finish()
    return count


def imported(path: str, dest: str) -> tuple[float, float, float]:
    """Seconds, peak memory before and after [MB] of an import, in a process of its own."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    options = LogOptions(wishes=Wishes(origin=Origin(0.75, 0.1)))
    seconds, _ = timed(lambda: import_dive(path, dest, options=options))
    return seconds, before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def read_by_mcap(path: str) -> float:
    """Seconds of the peer."""
    with Path(path).open("rb") as file:
        return timed(lambda: sum(1 for _ in make_reader(file).iter_messages(log_time_order=False)))[0]


def measured(case: str, gigabytes: float) -> Row:
    """One file, written, imported, read by the peer, and deleted."""
    with TemporaryDirectory(prefix="uwgraph-bench-") as work:
        path, dest = Path(work) / f"{case}.mcap", Path(work) / "dive"
        messages = write(path, case, int(gigabytes * 1e9))
        ((seconds, before, after),) = in_processes(imported, [(str(path), str(dest))])
        shutil.rmtree(dest)
        (peer,) = in_processes(read_by_mcap, [(str(path),)])
        size = path.stat().st_size / 1e6
    return {
        "case": case,
        "file MB": size,
        "messages": messages,
        "import s": seconds,
        "MB/s": size / seconds,
        "us a message": seconds / messages * 1e6,
        "mcap library s": peer,
        "libraries MB": before,
        "peak MB": after,
        "bytes a message": (after - before) * 1048576 / messages,
    }


def figures(rows: list[Row]) -> Iterator[Figure]:
    for row in rows:
        yield Figure(f"{row['case']}: peak memory [MB]", row["peak MB"], LIMIT_MB)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--gigabytes", type=float, default=2.0)
    options.add_argument("--case", nargs="+", choices=list(RATES_HZ), default=list(RATES_HZ))
    args = options.parse_args()
    rows = [measured(case, args.gigabytes) for case in args.case]
    finish(args, "import_memory", {f"{args.gigabytes:g} GB of MCAP": rows}, list(figures(rows)))


if __name__ == "__main__":
    main()
