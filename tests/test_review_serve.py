"""`review --serve`: rerun's web viewer on loopback, and what a browser shows there."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from conftest import further
from PIL import Image

import logs
from logs.run import Run
from planners.arena import Arena
from planners.maps import geojson
from sensorgraph.errors import SensorgraphError
from sensorgraph.show import rerun_file
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot

DEBUG_PORT = 9377


@pytest.fixture
def run_file(room: Arena, tmp_path: Path) -> Path:
    robot = parse_robot("sensor: {n_rays: 31}\n")
    t = np.arange(0.0, 6.0, 0.2)
    poses = np.column_stack([1.0 + 0.2 * t, np.full(len(t), 1.5), 0.3 * t])
    run = Run(
        sensor=robot.sensor, stamps=t, ranges=cast(room, poses, robot.sensor).ranges, pose_stamps=t, poses=poses,
        attachments={"arena.geojson": geojson.dumps(room).encode()},
    )  # fmt: skip
    logs.write(run, tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


@pytest.fixture
def address(run_file: Path) -> Iterator[str]:
    """Start the command, yield the address that it prints, and end it with Ctrl-C."""
    command = [sys.executable, "-c", "from sensorgraph.cli import main; main()", "review", str(run_file)]
    with subprocess.Popen(
        [*command, "-o", str(run_file.with_suffix(".rrd")), "--serve"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as work:  # fmt: skip
        assert work.stdout is not None
        for line in work.stdout:
            if found := re.fullmatch(r"serving (\S+)\n", line):
                yield found[1]
                break
        else:
            pytest.fail("no address was printed")
        work.send_signal(signal.SIGINT)
        assert work.wait(timeout=20) == 0
    (source,) = parse_qs(urlsplit(found[1]).query)["url"]
    end = time.monotonic() + 10
    while is_open(source) and time.monotonic() < end:
        time.sleep(0.1)
    assert not is_open(source)  # the viewer proper has ended, too


def is_open(address: str) -> bool:
    """Tell whether somebody listens there."""
    place = urlsplit(address)
    with socket.socket() as line:
        return line.connect_ex((place.hostname, place.port)) == 0


def test_the_page_and_the_recording_are_served_on_loopback_until_ctrl_c(address: str) -> None:
    page = urlsplit(address)
    assert page.hostname == "127.0.0.1"
    with urllib.request.urlopen(f"http://{page.netloc}/") as answer:
        assert b"rerun" in answer.read().lower()
    (source,) = parse_qs(page.query)["url"]
    assert is_open(source)


@pytest.mark.parametrize("number", further(signal.SIGTERM, signal.SIGKILL))
def test_the_viewer_ends_with_the_command(number: signal.Signals, run_file: Path) -> None:
    words = ["review", str(run_file), "-o", str(run_file.with_suffix(".rrd")), "--serve"]
    with subprocess.Popen(
        [sys.executable, "-m", "sensorgraph", *words], stdout=subprocess.PIPE, text=True
    ) as work:
        assert work.stdout is not None
        served = next(found[1] for line in work.stdout if (found := re.fullmatch(r"serving (\S+)\n", line)))
        (source,) = parse_qs(urlsplit(served).query)["url"]
        assert is_open(source)
        work.send_signal(number)
        assert work.wait(timeout=5) == (143 if number == signal.SIGTERM else -signal.SIGKILL)
    end = time.monotonic() + 5
    while is_open(source) and time.monotonic() < end:
        time.sleep(0.1)
    assert not is_open(source)


def test_a_server_that_does_not_start_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_file, "_viewer", lambda path: shutil.which("false"))
    with (
        pytest.raises(SensorgraphError, match="web viewer does not start"),
        rerun_file.served(tmp_path / "a.rrd"),
    ):
        pass


@pytest.mark.slow
def test_a_browser_shows_the_layout_of_the_review(address: str, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    drawn = [
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist",
    ]
    started = [
        "--headless=new",
        "--no-sandbox",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=1400,900",
    ]
    port = [f"--remote-debugging-port={DEBUG_PORT}", "--remote-allow-origins=*"]
    with subprocess.Popen(
        [browser, *started, *drawn, *port, f"{address}&renderer=webgl"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as shown:  # fmt: skip
        try:
            end, dark, n_greys = time.monotonic() + 120, 0.0, 0
            # the review's views are dark, the welcome page is light, and while the viewer loads all is one grey
            while (dark < 0.4 or n_greys <= 50) and time.monotonic() < end:
                time.sleep(2)
                with suppress(OSError, ValueError):  # a slow machine: no browser, or no page in it yet
                    picture = np.asarray(screenshot().convert("L"))
                    dark, n_greys = float((picture < 60).mean()), len(np.unique(picture))
        finally:
            shown.kill()
    assert dark > 0.4
    assert n_greys > 50  # and something is drawn in them


def screenshot() -> Image.Image:
    """Ask Chromium's DevTools for a picture of the page (Page.captureScreenshot over a web socket, RFC 6455)."""
    with urllib.request.urlopen(f"http://127.0.0.1:{DEBUG_PORT}/json") as answer:
        (page,) = [entry for entry in json.load(answer) if entry["type"] == "page"]
    target = urlsplit(page["webSocketDebuggerUrl"])
    with socket.create_connection((target.hostname, target.port), timeout=60) as line:
        key = base64.b64encode(os.urandom(16)).decode()
        line.sendall(
            f"GET {target.path} HTTP/1.1\r\nHost: {target.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += line.recv(1)
        asked, mask = json.dumps({"id": 1, "method": "Page.captureScreenshot"}).encode(), os.urandom(4)
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(asked))
        line.sendall(bytes([0x81, 0x80 | len(asked)]) + mask + masked)
        stream, data, is_last = line.makefile("rb"), b"", False
        while not is_last:
            first, length = stream.read(2)
            if length in (126, 127):
                (length,) = struct.unpack(
                    ">H" if length == 126 else ">Q", stream.read(2 if length == 126 else 8)
                )
            data, is_last = data + stream.read(length), bool(first & 0x80)
    return Image.open(io.BytesIO(base64.b64decode(json.loads(data)["result"]["data"])))
