"""ArduSub logs made to measure: DataFlash by its own rules, telemetry with pymavlink."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT
from pymavlink.dialects.v20 import ardupilotmega as mavlink

START_US = 1_726_000_000_000_000
"""2024-09-10T20:26:40Z."""
_UNITS = {"s": "s", "#": "instance", "E": "rad/s", "o": "m/s/s", "P": "Pa", "m": "m", "n": "m/s", "h": "degheading"}
_UNITS |= {"d": "deg", "D": "deglatitude", "U": "deglongitude", "-": ""}
_SCALES = {"-": 0.0, "F": 1e-6, "0": 1.0, "C": 1e-3}
KINDS = {
    "IMU": (10, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "s#EEEooo", "F-000000"),
    "BARO": (11, "QBff", "TimeUS,I,Alt,Press", "s#mP", "F-00"),
    "ATT": (12, "QccC", "TimeUS,Roll,Pitch,Yaw", "sddh", "F000"),
    "GPS": (13, "QBIHLL", "TimeUS,Status,GMS,GWk,Lat,Lng", "s---DU", "F---00"),
    "PARM": (14, "QNf", "TimeUS,Name,Value", "s--", "F--"),
    "VISO": (15, "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf", "s--------", "F--------"),
    "XKF1": (16, "QBccCfff", "TimeUS,C,Roll,Pitch,Yaw,PN,PE,PD", "s#ddhmmm", "F-000000"),
    "XKF4": (17, "QBI", "TimeUS,C,SS", "s#-", "F--"),
    "ORGN": (18, "QBLL", "TimeUS,Type,Lat,Lng", "s-DU", "F-00"),
}
"""Type, letters, columns, units, multipliers."""


def message(kind: int, letters: str, *values: Any) -> bytes:
    """One DataFlash message of raw values (before any scale of its letters)."""
    texts = [value.encode() if isinstance(value, str) else value for value in values]
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(FORMAT_TO_STRUCT[c][0] for c in letters), *texts)


def definition(kind: int, name: str, letters: str, columns: str) -> bytes:
    length = 3 + struct.calcsize("<" + "".join(FORMAT_TO_STRUCT[c][0] for c in letters))
    return message(128, "BBnNZ", kind, length, name, letters, columns)


def head() -> bytes:
    """The definitions that a log begins with."""
    parts = [definition(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    parts += [definition(1, "UNIT", "QbZ", "TimeUS,Id,Label"), definition(2, "MULT", "Qbd", "TimeUS,Id,Mult")]
    parts += [definition(3, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")]
    parts += [message(1, "QbZ", 5, ord(letter), label) for letter, label in _UNITS.items()]
    parts += [message(2, "Qbd", 5, ord(letter), scale) for letter, scale in _SCALES.items()]
    for name, (kind, letters, columns, units, scales) in KINDS.items():
        parts += [definition(kind, name, letters, columns), message(3, "QBNN", 6, kind, units, scales)]
    return b"".join(parts)


def of(name: str, *values: Any) -> bytes:
    return message(*KINDS[name][:2], *values)


def onboard(seconds: float = 20.0, rate: int = 50, *, gps: bool = True, aided: bool = True) -> bytes:
    """A log of a vehicle that sinks slowly while it turns: IMU, two barometers, attitude, DVL, and the date."""
    rng = np.random.default_rng(1)
    parts = [head(), of("PARM", 10, "COMPASS_DEC", 0.27), of("PARM", 11, "AHRS_TRIM_X", 0.02)]
    if aided:
        parts.append(of("ORGN", 20, 0, 483861418, -1246305732))
    for k in range(int(seconds * rate)):
        us = 60_000_000 + round(1e6 * k / rate)
        t = k / rate
        parts.append(of("IMU", us, 0, *rng.normal([0.01, 0.0, 0.1], 1e-3), *rng.normal([0.1, 0.0, -9.8], 1e-2)))
        if k % 5 == 0:
            parts.append(of("BARO", us, 0, -8.0 - 0.03 * t, 1.0e5 + 0.36 * t))
            parts.append(of("BARO", us, 1, -0.1 * t, 101_000.0 + 981.0 * t))
            parts.append(of("ATT", us, 10, -50, round(100 * ((200.0 + 5.7 * t) % 360.0))))
            parts.append(
                of("XKF1", us, 0, 10, -50, round(100 * ((200.0 + 5.7 * t) % 360.0)), 0.5 * t, 0.1 * t, 0.1 * t)
            )
            parts.append(of("XKF4", us, 0, 0x3F if aided else 0xA7))
        if k % 10 == 0 and aided:
            parts.append(of("VISO", us, 0.2, 0.0, 0.0, 0.02, 0.1, 0.02, 0.0, 100.0 if t < 10.0 else 0.0))
        if k % rate == 0 and gps:
            ms = 158_400_000 + us // 1000
            parts.append(of("GPS", us + 150, 3 if t < 3.0 else 1, ms, 2331, 483861418 + 100 * k, -1246305732))
    return b"".join(parts)


def telemetry(messages: Sequence[tuple[int, tuple[int, int], Any]], *, v1: bool = False) -> bytes:
    """A telemetry log: when each message was received (us since :data:`START_US`), who sent it, pymavlink's message."""
    senders: dict[tuple[int, int], mavlink.MAVLink] = {}
    parts = []
    for received_us, source, sent in messages:
        sender = senders.setdefault(source, mavlink.MAVLink(None, *source))
        parts.append(struct.pack(">Q", START_US + received_us) + sent.pack(sender, force_mavlink1=v1))
        sender.seq = (sender.seq + 1) % 256
    return b"".join(parts)


def dive(seconds: float = 20.0, rate: int = 50, boot_ms: int = 60_000, at_us: int = 0) -> list[tuple[int, Any, Any]]:
    """Messages of a vehicle that sinks slowly, over a link that delays them by 2 ms and more."""
    rng = np.random.default_rng(2)
    vehicle, companion = (1, 1), (1, 220)
    found: list[tuple[int, Any, Any]] = []
    for k in range(int(seconds * rate)):
        us = round(1e6 * k / rate)
        ms = boot_ms + us // 1000

        def send(sent: Any, source: tuple[int, int] = vehicle, us: int = us) -> None:
            found.append((at_us + us + 2000 + int(rng.exponential(3000.0)), source, sent))

        f, w = rng.normal([100, 0, -9800], 10.0) * 1e-3, rng.normal([10, 0, 100], 1.0) * 1e-3
        send(mavlink.MAVLink_highres_imu_message(boot_ms * 1000 + us, *f, *w, *[0.0] * 7, 63))
        if k % 5 == 0:
            t = us * 1e-6
            send(mavlink.MAVLink_scaled_pressure_message(ms, 1000.0, 0.0, 3000))
            send(mavlink.MAVLink_scaled_pressure2_message(ms, 1013.0 + 9.8 * t, 0.0, 1200))
            send(mavlink.MAVLink_attitude_message(ms, 0.01, -0.02, (0.5 + 0.1 * t) % 3.0, 0.0, 0.0, 0.1))
            send(mavlink.MAVLink_named_value_float_message(ms, b"Lights1", 0.25))
            send(
                mavlink.MAVLink_vision_position_delta_message(0, 100_000, [0.0] * 3, [0.05, 0.01, 0.0], 90.0), companion
            )
        if k % rate == 0:
            send(mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3))
            send(mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3), (255, 190))
            send(mavlink.MAVLink_gps_raw_int_message((ms - 400) * 1000, 3, 483861418, -1246305732, 0, 99, 99, 0, 0, 9))
            send(mavlink.MAVLink_param_value_message(b"COMPASS_DEC", 0.0, 9, 900, 1))
    return sorted(found, key=lambda stamped: stamped[0])
