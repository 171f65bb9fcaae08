import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road import Route
from tests.traffic_bridge.recorded_drive import STEPS, changed, config, record
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import Recording, ReSim, TrafficConfig
from traffic_bridge.modes.resim import difference

AGAIN = """
import sys
from iits_mj.road import Route
from traffic_bridge import ReSim
with ReSim(Route.straight(length=4000.0), sys.argv[1]) as again:
    print(again.verify())
"""


@pytest.fixture(scope="module", params=["lc2013", "mobil"])
def recorded(straight, tmp_path_factory, request):
    return record(straight, tmp_path_factory.mktemp("recording") / "drive", request.param)


@pytest.fixture(scope="module")
def one(straight, tmp_path_factory):
    return record(straight, tmp_path_factory.mktemp("recording") / "drive", steps=20)[0]


def test_rerun_is_bit_identical_for_any_state_of_the_truck(straight, recorded):
    path, frames = recorded
    with ReSim(straight, path) as again:
        assert again.reset() == frames[0]
        assert again.step(ego_at(straight, 0.1, 2000.0, 3.0, 0.0)) == frames[1]
        assert again.verify() == again.recording.meta["digest"]
        with pytest.raises(TrafficError, match=f"ends after {STEPS} steps"):
            again.step()


def test_rerun_in_another_process_has_the_hash_of_the_recording(recorded):
    path, _ = recorded
    environment = dict(os.environ, PYTHONHASHSEED="7")
    again = subprocess.run(
        [sys.executable, "-c", AGAIN, str(path)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert again.stdout.strip() == Recording.load(path).meta["digest"], again.stderr


def test_one_drive_gives_one_file_byte_for_byte(straight, one, tmp_path):
    again, _ = record(straight, tmp_path / "again", steps=20)
    assert again.read_bytes() == one.read_bytes()


def test_another_map_is_refused(one):
    with pytest.raises(InputError, match=r"made on map .* of hash \w{12}, not on"):
        ReSim(Route.straight(length=3990.0), one)


def test_another_option_is_refused_by_name(straight, one):
    other = TrafficConfig(density=0.1, fill_ahead=600.0, fill_behind=600.0)
    with pytest.raises(InputError, match="other options: density"):
        ReSim(straight, one, other)
    with ReSim(straight, one, config()) as again:
        assert len(again) == 21


@pytest.mark.parametrize("name", ["libsumo", "numpy", "iits-mj", "schema"])
def test_another_version_is_refused_by_name(straight, one, tmp_path, name):
    versions = Recording.load(one).meta["versions"] | {name: "0.0.1"}
    path = changed(one, tmp_path / "old.npz", versions=versions)
    with pytest.raises(InputError, match=rf"made with {name} 0\.0\.1, here is"):
        ReSim(straight, path)


def test_another_net_is_refused(straight, one, tmp_path):
    path = changed(one, tmp_path / "net.npz", net_hash="0" * 64)
    with pytest.raises(InputError, match="a SUMO net of hash 000000000000, here is"):
        ReSim(straight, path)


def test_an_imported_data_set_cannot_be_rerun(straight, one, tmp_path):
    path = changed(one, tmp_path / "laid.npz", mode="data")
    with pytest.raises(InputError, match="mode 'data' cannot be re-run"):
        ReSim(straight, path)


@pytest.mark.parametrize("settings", [{"config": {}}, {"config": None}, {"seed": "1"}])
def test_missing_settings_are_refused(straight, one, tmp_path, settings):
    path = changed(one, tmp_path / "settings.npz", **settings)
    with pytest.raises(InputError, match=r"settings|configuration"):
        ReSim(straight, path)


def test_a_changed_pose_is_reported_with_its_time_and_vehicle(straight, one, tmp_path):
    with np.load(one) as file:
        arrays = dict(file)
    row = int(arrays["frame_start"][13])
    arrays["x"][row] = np.nextafter(arrays["x"][row], np.inf)
    name = arrays["vehicle_id"][arrays["vehicle"][row]]
    path = tmp_path / "pose.npz"
    np.savez(path, **arrays)
    with (
        ReSim(straight, path) as again,
        pytest.raises(TrafficError, match=rf"t = 1\.30 s, where x of vehicle '{name}'"),
    ):
        again.verify()


def test_a_changed_hash_is_reported(straight, one, tmp_path):
    path = changed(one, tmp_path / "hash.npz", digest="0" * 64)
    with ReSim(straight, path) as again, pytest.raises(TrafficError, match="recorded 000000000000"):
        again.verify()


def test_another_path_of_the_truck_gives_other_traffic(straight, one, tmp_path):
    with np.load(one) as file:
        arrays = dict(file)
    names = arrays["ego_columns"].tolist()
    for name, value in (("speed", 0.0), ("x", 1000.0), ("station", 1000.0)):
        arrays["ego"][1:, names.index(name)] = value
    path = tmp_path / "other.npz"
    np.savez(path, **arrays)
    with ReSim(straight, path) as again, pytest.raises(TrafficError, match="first at t = "):
        again.verify()


def test_difference_names_the_missing_vehicle(recorded):
    frames = recorded[1]
    short = frames[0].select(np.arange(len(frames[0])) > 0)
    assert "is missing" in difference(frames[0], short)
    assert "in addition" in difference(short, frames[0])
    assert difference(frames[0], frames[0]) == ""


def test_meta_is_plain_json(one):
    meta = Recording.load(one).meta
    assert json.loads(json.dumps(meta)) == meta
    assert Path(meta["map_name"]).name == meta["map_name"]
    assert len(meta["digest"]) == len(meta["net_hash"]) == 64
