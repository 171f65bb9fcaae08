"""Two processes and a real clock: an external controller drives the served truck over UDP."""

from __future__ import annotations

import ast
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.paths import ROOT

GROUP = "239.74.163.2"
SERVE = [sys.executable, "-m", "iits_mj.cli", "serve", "--json"]
# The truck rolls on while the controller starts.
ROLLING = ("--on-silence", "release")


def _multicast_is_routed() -> bool:
    """Returns whether a datagram to the group returns to this machine."""
    membership = socket.inet_aton(GROUP) + struct.pack("@I", socket.INADDR_ANY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 0))
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            probe.settimeout(1.0)
            probe.sendto(b"there", (GROUP, probe.getsockname()[1]))
            return probe.recv(16) == b"there"
        except OSError:
            return False


pytestmark = pytest.mark.skipif(
    not _multicast_is_routed(), reason=f"UDP multicast to {GROUP} is not routed here"
)


@pytest.fixture
def port() -> int:
    """A free UDP port, so that parallel tests share no bus."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def _start(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        words, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def _serve(port: int, *words: str) -> subprocess.Popen[str]:
    return _start(*SERVE, "--bus", "udp_multicast", "--channel", f"{GROUP}:{port}", *words)


def _summary(server: subprocess.Popen[str]) -> dict[str, Any]:
    server.send_signal(signal.SIGTERM)
    out, err = server.communicate(timeout=30)
    assert server.returncode == 0, err
    summary: dict[str, Any] = json.loads(out)["summary"]
    return summary


def _drive(example: str, port: int, seconds: int, *words: str) -> tuple[int, str]:
    channel = {
        "keep_speed.py": ["--channel", GROUP, "--port", str(port)],
        "stack_over_bus.py": ["--channel", f"{GROUP}:{port}"],
    }[example]
    driver = _start(
        sys.executable, f"examples/{example}", *channel, "--duration", str(seconds), *words
    )
    out, err = driver.communicate(timeout=seconds + 60)
    return driver.returncode, out + err


def _figures(text: str) -> tuple[float, float]:
    """Returns worst speed error [km/h] and distance from the line [m] of an example."""
    found = re.search(r"worst ([\d.]+) km/h; off .* at most ([\d.]+) m", text)
    assert found is not None, text
    return float(found[1]), float(found[2])


def test_the_example_controller_imports_no_project_code() -> None:
    tree = ast.parse((ROOT / "examples" / "keep_speed.py").read_text(encoding="utf-8"))
    modules = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in (
            [node.module] if isinstance(node, ast.ImportFrom) else [n.name for n in node.names]
        )
        if name is not None
    }
    assert modules - set(sys.stdlib_module_names) == {"can", "cantools"}


def test_controller_in_another_process_keeps_60_kmh_for_10_s(
    port: int, processes: list[subprocess.Popen[str]]
) -> None:
    server = _serve(port, "--start-speed", "16.67", "--payload", "10000", *ROLLING)
    processes.append(server)
    code, reported = _drive("keep_speed.py", port, 10, "--settle", "3")
    assert code == 0, reported
    speed, line = _figures(reported)
    assert speed < 3.0
    assert line < 0.3
    time.sleep(0.4)
    summary = _summary(server)
    assert summary["ended"] == "ended by SIGTERM"
    assert summary["rejected"] == {}
    assert summary["accepted"]["IITS_COMMAND"] > 450
    assert summary["silences"] >= 1
    assert summary["distance_m"] == pytest.approx(10 * 16.67, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("example", ["keep_speed.py", "stack_over_bus.py"])
def test_controller_in_another_process_keeps_60_kmh_for_60_s(
    example: str, port: int, processes: list[subprocess.Popen[str]]
) -> None:
    server = _serve(port, "--start-speed", "16.67", "--start-station", "950", *ROLLING)
    processes.append(server)
    # The laden truck starts on a grade without power, loses 3.2 km/h and regains it at full pedal.
    code, reported = _drive(example, port, 70, "--settle", "10")
    assert code == 0, reported
    speed, line = _figures(reported)
    assert speed < 3.0
    assert line < 0.3
    summary = _summary(server)
    assert summary["rejected"] == {}
    assert summary["accepted"]["IITS_COMMAND"] > 2800


def test_ctrl_c_ends_with_a_summary(port: int, processes: list[subprocess.Popen[str]]) -> None:
    server = _serve(port)
    processes.append(server)
    assert server.stderr is not None
    assert "serving on CAN bus" in server.stderr.readline()
    server.send_signal(signal.SIGINT)
    out, err = server.communicate(timeout=30)
    assert server.returncode == 0, err
    assert json.loads(out)["summary"]["ended"] == "ended by SIGINT"


def test_a_missing_can_interface_is_one_line_without_driver_output() -> None:
    done = subprocess.run(
        [*SERVE, "--bus", "socketcan", "--channel", "no_can9"],
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert "CAN bus socketcan:no_can9 cannot be opened" in done.stderr


NETWORK = """
up() { ip link set lo up multicast on; ip route replace 239.0.0.0/8 dev lo; }
up
"$@" --payload 10000 --start-speed 16 --on-silence release --duration 60 & served=$!
trap 'kill $served 2>/dev/null' EXIT
"$PYTHON" examples/keep_speed.py --duration 4 --settle 3 >&2
[ $? = 2 ] && exit 10
ip link set lo down
sleep 2
up
sleep 3
"$PYTHON" examples/keep_speed.py --duration 4 --settle 3 >&2
[ $? = 2 ] && exit 11
kill -TERM $served
wait $served
"""


def _own_network() -> list[str]:
    """Returns a command prefix for a separate network, or skips the test."""
    words = ["unshare", "--net", "--map-root-user"]
    probe = [*words, "sh", "-c", "ip link set lo up multicast on"]
    try:
        possible = subprocess.run(probe, capture_output=True, timeout=10).returncode == 0
    except OSError:
        possible = False
    if not possible:
        pytest.skip("this machine has no separate networks (unshare, ip)")
    return words


@pytest.mark.slow
def test_serving_continues_after_the_network_goes_down_and_returns() -> None:
    words = [*_own_network(), "sh", "-c", NETWORK, "sh", *SERVE, "--bus", "udp_multicast"]
    done = subprocess.run(
        words,
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=120,
        env=os.environ | {"PYTHON": sys.executable},
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)["summary"]
    assert summary["bus_state"] == "up"
    assert summary["bus_failures"] >= 1
    assert summary["bus_restarts"] >= 1
    assert summary["dropped"] > 100
    assert summary["silences"] >= 1
    assert summary["rejected"] == {}
    assert "is down, will be reopened" in done.stderr
    assert "is up again" in done.stderr
