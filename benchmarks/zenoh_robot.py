"""A ROS 2 robot on zenoh, as rmw_zenoh publishes, for tests and `benchmarks.infrastructure`.

Plain zenoh, and messages packed by hand: no code in common with what listens.
    python -m benchmarks.zenoh_robot --port 7447 --duration 60
"""

from __future__ import annotations

import argparse
import math
import socket
import struct
import time
from collections.abc import Sequence
from random import Random
from typing import Any

import zenoh
import zenoh.ext

HUMBLE = "TypeHashNotSupported"
KILTED = "RIHS01_" + "ab" * 32
TYPES = {
    "/scan": "sensor_msgs::msg::dds_::LaserScan_",
    "/pose": "geometry_msgs::msg::dds_::PoseStamped_",
    "/odom": "nav_msgs::msg::dds_::Odometry_",
    "/cmd_vel": "geometry_msgs::msg::dds_::TwistStamped_",
    "/tf_static": "tf2_msgs::msg::dds_::TFMessage_",
    "/chatter": "std_msgs::msg::dds_::String_",
}


class Cdr:
    """Little-endian CDR, field by field."""

    def __init__(self) -> None:
        self.data = bytearray(b"\x00\x01\x00\x00")

    def put(self, form: str, *values: float) -> Cdr:
        size = struct.calcsize("<" + form[-1])
        self.data += b"\x00" * (-(len(self.data) - 4) % size)
        self.data += struct.pack("<" + form, *values)
        return self

    def text(self, text: str) -> Cdr:
        self.put("I", len(text) + 1)
        self.data += text.encode() + b"\x00"
        return self

    def header(self, stamp: float, frame: str) -> Cdr:
        return self.put("i", int(stamp)).put("I", round(stamp % 1 * 1e9)).text(frame)

    def pose(self, x: float, y: float, phi: float) -> Cdr:
        return self.put("7d", x, y, 0.0, 0.0, 0.0, math.sin(phi / 2), math.cos(phi / 2))


def scan(stamp: float, ranges: Sequence[float], rate: float) -> bytes:
    n = len(ranges)
    message = Cdr().header(stamp, "laser")
    message.put("7f", -math.pi / 2, math.pi / 2, math.pi / (n - 1), 0.0, 1 / rate, 0.05, 12.0)
    message.put("I", n).put(f"{n}f", *ranges).put("I", n).put(f"{n}f", *([0.5] * n))
    return bytes(message.data)


def pose(stamp: float, x: float, y: float, phi: float) -> bytes:
    return bytes(Cdr().header(stamp, "map").pose(x, y, phi).data)


def odometry(stamp: float, x: float, y: float, phi: float, v: float, omega: float) -> bytes:
    message = Cdr().header(stamp, "odom").text("base_link").pose(x, y, phi).put("36d", *([0.0] * 36))
    return bytes(message.put("6d", v, 0, 0, 0, 0, omega).put("36d", *([0.0] * 36)).data)


def command(stamp: float, v: float, omega: float) -> bytes:
    return bytes(Cdr().header(stamp, "base_link").put("6d", v, 0, 0, 0, 0, omega).data)


def mount(stamp: float, x: float, y: float, phi: float) -> bytes:
    return bytes(Cdr().put("I", 1).header(stamp, "base_link").text("laser").pose(x, y, phi).data)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def open_session(mode: str, port: int) -> zenoh.Session:
    """Open a router on a port of this machine, or a client of it."""
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    config.insert_json5("connect/retry", '{"period_init_ms": 100, "period_max_ms": 200}')
    ends = "listen/endpoints" if mode == "router" else "connect/endpoints"
    config.insert_json5(ends, f'["tcp/127.0.0.1:{port}"]')
    return zenoh.open(config)


class Robot:
    """Publishers of some topics, announced by tokens, each message with its count beside it."""

    def __init__(self, port: int, topics: Sequence[str], *, domain: int = 0, type_hash: str = KILTED) -> None:
        self.session = open_session("client", port)
        self.counts = dict.fromkeys(topics, 0)
        self.publishers: dict[str, Any] = {}
        self.tokens = []
        for number, topic in enumerate(topics):
            key = f"{domain}{topic}/{TYPES[topic]}/{type_hash}"
            latched = topic == "/tf_static"
            self.publishers[topic] = (
                zenoh.ext.declare_advanced_publisher(
                    self.session, key, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
                )
                if latched
                else self.session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
            )
            quality = f"{'' if not latched else 1}:{1 if latched else ''}:,10:,:,:,,"
            token = f"@ros2_lv/{domain}/5eed/0/{number}/MP/%/%/base/{topic.replace('/', '%')}/{TYPES[topic]}/{type_hash}/{quality}"
            self.tokens.append(self.session.liveliness().declare_token(token))

    def wait_for_listener(self, topic: str = "/scan", timeout: float = 20.0) -> None:
        until = time.monotonic() + timeout
        while not self.publishers[topic].matching_status.matching:
            assert time.monotonic() < until, "nobody listens"
            time.sleep(0.02)

    def send(self, topic: str, message: bytes, *, skip: bool = False) -> None:
        """Publish a message, or only count it, as one that is lost on the way."""
        self.counts[topic] += 1
        if not skip:
            beside = struct.pack("<qqB", self.counts[topic], time.time_ns(), 16) + bytes(16)
            self.publishers[topic].put(message, attachment=beside)

    def drive(
        self, duration: float, *, rate: float, n_rays: int, noise: float = 0.0, begin: float = 0.0
    ) -> int:
        """Publish scans at a rate, and pose, odometry and commands with each, on a circle; return how many.

        Stamps begin at `begin` [s] after an epoch of its own.
        """
        draw = Random(0)
        scans = [[2.0 + 0.001 * k + draw.gauss(0, noise) for k in range(n_rays)] for _ in range(64)]
        began = time.monotonic()
        n = round(duration * rate)
        for k in range(n):
            stamp = 1_700_000_000.0 + begin + k / rate
            phi = 0.5 * k / rate
            x, y = 2 + math.sin(phi), 2 - math.cos(phi)
            for topic, message in (
                ("/pose", pose(stamp, x, y, phi)),
                ("/odom", odometry(stamp, x - 2, y - 1, phi, 0.5, 0.5)),
                ("/cmd_vel", command(stamp, 0.5, 0.5)),
                ("/scan", scan(stamp, scans[k % 64], rate)),
            ):
                if topic in self.publishers:
                    self.send(topic, message)
            time.sleep(max(began + (k + 1) / rate - time.monotonic(), 0.0))
        return n

    def close(self) -> None:
        self.session.close()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, default=7447)
    parser.add_argument("--duration", type=float, default=600.0)
    parser.add_argument("--rate", type=float, default=40.0)
    parser.add_argument("--rays", type=int, default=1081)
    options = parser.parse_args()
    robot = Robot(options.port, ["/tf_static", "/pose", "/odom", "/cmd_vel", "/scan"])
    robot.send("/tf_static", mount(1_700_000_000.0, 0.1, 0.0, 0.0))
    robot.wait_for_listener(timeout=60.0)
    time.sleep(0.5)  # the other topics follow
    print(robot.drive(options.duration, rate=options.rate, n_rays=options.rays, noise=0.01), flush=True)
    time.sleep(2.0)
    robot.close()


if __name__ == "__main__":
    main()
