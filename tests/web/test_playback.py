import threading
import time

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.web import TrackObserver, WebServer, replay_page
from iits_mj.web.playback import Playback

pytest.importorskip("mjviser")
from iits_mj.web.scene import Poses


@pytest.fixture(scope="module")
def track():
    with Simulation(DriveConfig(duration=5.0), visuals=False) as simulation:
        observer = TrackObserver(simulation)
        simulation.run([observer])
    return observer.track


def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def _interrupt(value):
    raise KeyboardInterrupt


def test_a_drive_is_played_to_its_end_and_sought(track):
    with WebServer(port=0, title="a test") as server:
        show = Playback(server, track, pace=4.0)
        show._handlers["end"] = _interrupt
        thread = threading.Thread(target=show.run)
        thread.start()
        until(lambda: show.now == track.duration)
        show.looks.put("pause", True)
        until(lambda: show.paused)
        for place in (2.0, 0.0, -1.0, 99.0, 3.33):
            show.message(1, {"seek": place})
            wanted = min(max(place, 0.0), track.duration)
            until(lambda wanted=wanted: show.now == wanted)
        until(lambda: show.paused)
        assert show.state()["timeline"] == [3.33, 5.0]
        show.message(1, {"seek": float("nan")})
        show.message(1, {"seek": "1"})
        show.requests.put("end")
        thread.join(60.0)
        assert not thread.is_alive()
        assert show.now == 3.33


def test_a_page_replays_a_drive_without_a_server(track, tmp_path):
    shares = []
    path = replay_page(track, tmp_path / "replay.html", rate=5.0, progress=shares.append)
    text = path.read_text(encoding="utf-8")
    assert "__VISER_EMBED_DATA__" in text
    assert shares[-1] == 1.0
    assert len(shares) == 26
    # Only the landscape near the drive is in it.
    assert 1e6 < path.stat().st_size < 6e6


def test_a_replay_cannot_start_after_the_end(track, tmp_path):
    with pytest.raises(InputError, match="beyond the drive"):
        replay_page(track, tmp_path / "replay.html", start=9.0)


def test_poses_between_two_instants_lie_between_them():
    first = Poses(np.zeros((3, 3)), np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 0, 0, 0]]))
    second = Poses(
        np.array([[2.0, 0, 0], [0, 0, 0], [900.0, 0, 0]]),
        np.array([[0.0, 0, 0, 1.0], [0, -1.0, 0, 0], [0.0, 1.0, 0, 0]]),
    )
    middle = first.toward(second, 0.5)
    assert middle.position[0] == pytest.approx([1.0, 0.0, 0.0])
    assert middle.quaternion[0] == pytest.approx([0.5**0.5, 0.0, 0.0, 0.5**0.5])
    # A quaternion and its negative are the same rotation.
    assert abs(middle.quaternion[1]) == pytest.approx([0.0, 1.0, 0.0, 0.0])
    # A body that jumps to another vehicle is there at once.
    assert middle.position[2] == pytest.approx([900.0, 0.0, 0.0])
