"""A drive in the browser with parts of the user's own."""

import pytest

from iits_mj.core.messages import Decision
from iits_mj.simulation import DriveConfig
from iits_mj.web import WebServer
from iits_mj.web.live import LiveDrive
from tests.paths import ROOT

pytest.importorskip("mjviser")


class Keeping:
    def reset(self):
        pass

    def decide(self, context):
        return Decision.KEEP


def test_pages_begin_with_the_own_camera_and_the_own_parts_drive_on(monkeypatch):
    monkeypatch.chdir(ROOT)
    camera = "examples/own_camera.py:Orbit:distance=40"
    config = DriveConfig(
        traffic_mode="examples/own_traffic.py:Wave",
        lateral="examples/own_lateral.py:Stanley",
        decision=Keeping,
        speed_planner="cruise",
    )
    with (
        WebServer(port=0, title="a test") as server,
        LiveDrive(server, config, pace=20.0, camera=camera) as drive,
    ):
        drive._show_model()
        assert drive.scene.view_of(1) == camera
        drive.scene.use_view(1, camera)
        for _ in range(3):
            drive.simulation.cycle([drive])
        assert drive.simulation.vehicles.ids == ("wave",)
        drive._set_speed(12.0)
        drive.simulation.cycle([drive])
        assert type(drive.driver.automatic.decision_maker.part) is Keeping
        assert drive.state()["choice"]
