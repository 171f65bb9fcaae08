"""The truck's model, the film's pictures and the layout that a bag has for Foxglove."""

import io
import json

import numpy as np
import pytest

from iits_mj.bag import foxglove
from iits_mj.bag.mcap_file import PICTURES, TOPICS, BagWriter
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.render.video import Mp4Encoder
from iits_mj.simulation import DriveConfig, Simulation

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("mjviser")
pytest.importorskip("rosbags")
pytest.importorskip("libsumo")
mcap_reader = pytest.importorskip("mcap.reader")
mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")

SIZE, FPS, COLORS = (64, 48), 20.0, (200, 30, 90)


@pytest.mark.parametrize("name", shipped_trucks())
def test_the_model_of_each_unit_has_its_dimensions_in_its_frame(name):
    parameters = TruckParameters.load(name)
    models = foxglove.unit_models(parameters, parameters.payload_max)
    assert list(models) == [unit.name for unit in parameters.units]
    for unit in parameters.units:
        scene = trimesh.load(io.BytesIO(models[unit.name]), file_type="glb")
        (rear, low, _), (front, high, _) = scene.bounds
        # glTF has y upward. Mirrors, lamps and bumpers stand out of the body.
        # A drawbar begins at its eye, ahead of the body; a B-double's axles lie behind the body.
        behind = max(unit.length - unit.front_overhang, unit.axles[-1].position + 0.6)
        assert front == pytest.approx(max(unit.front_overhang, 0.0), abs=0.15)
        assert -rear == pytest.approx(behind, abs=0.5)
        assert low == pytest.approx(0.0, abs=0.05)  # the tires stand on the road
        assert high == pytest.approx(unit.height, abs=0.35)
        assert len(models[unit.name]) < 1_000_000


def test_a_lifted_axle_is_off_the_road():
    parameters = TruckParameters.load("tractor_semitrailer_6x2")
    empty, laden = (
        foxglove.unit_models(parameters, payload)["tractor"]
        for payload in (0.0, parameters.payload_max)
    )
    assert empty != laden


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """Folder of a bag with the pictures of a film of 2 s, and its messages by topic."""
    folder = tmp_path_factory.mktemp("filmed")
    video = folder / "film.mp4"
    with Mp4Encoder(video, SIZE, FPS) as encoder:
        for number in range(40):
            encoder.add(np.full((*SIZE[::-1], 3), COLORS[number * 3 // 40], dtype=np.uint8))
    config = DriveConfig(duration=2.0, truck="b_double", payload=0.0)
    with (
        Simulation(config, visuals=False) as simulation,
        BagWriter(folder / "bag", simulation, video) as bag,
    ):
        simulation.run([bag])
    found = {}
    (path,) = (folder / "bag").glob("*.mcap")
    with path.open("rb") as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[mcap_ros2.DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time * 1e-9, decoded))
    return folder / "bag", found


def test_the_model_is_fixed_to_the_frames_of_the_units(filmed):
    ((time, update),) = filmed[1]["/vehicle/model"]
    assert time == 0.0
    assert [entity.frame_id for entity in update.entities] == ["tractor", "lead_trailer", "trailer"]
    frames = {"tractor", *(t.child_frame_id for t in filmed[1]["/tf"][0][1].transforms)}
    for entity in update.entities:
        assert entity.frame_locked
        assert entity.frame_id in frames
        (model,) = entity.models
        assert model.media_type == foxglove.GLTF
        trimesh.load(io.BytesIO(bytes(model.data)), file_type="glb")


def test_the_pictures_of_the_film_have_their_times(filmed):
    from PIL import Image

    pictures = filmed[1][PICTURES]
    assert [round(time, 6) for time, _ in pictures] == [
        k / foxglove.PICTURE_RATE for k in range(10)
    ]
    for time, message in pictures:
        assert message.format == "jpeg"
        picture = Image.open(io.BytesIO(bytes(message.data)))
        assert picture.size == SIZE
        expected = COLORS[round(time * FPS) * 3 // 40]
        assert np.asarray(picture).mean() == pytest.approx(expected, abs=4.0)


def test_the_layout_shows_topics_and_fields_of_the_bag(filmed):
    folder, messages = filmed
    content = json.loads((folder / foxglove.LAYOUT).read_text())
    panels = content["configById"]

    def arranged(node):
        return (
            [node]
            if isinstance(node, str)
            else [*arranged(node["first"]), *arranged(node["second"])]
        )

    assert sorted(arranged(content["layout"])) == sorted(panels)
    topics = set(panels["3D!scene"]["topics"]) | {panels["RawMessages!decision"]["topicPath"]}
    topics |= {panels["Image!film"]["imageMode"]["imageTopic"]}
    assert topics <= set(TOPICS) | {PICTURES}
    assert panels["3D!scene"]["followTf"] == "tractor"
    for panel in panels.values():
        for path in panel.get("paths", ()):
            topic, _, field = path["value"].partition(".")
            value = getattr(messages[topic][0][1], field.removesuffix("[0]"))
            assert np.isfinite(value[0] if field.endswith("[0]") else value)


def test_a_bag_without_a_film_has_no_pictures_and_no_panel_for_them(tmp_path):
    with (
        Simulation(DriveConfig(duration=1.0), visuals=False) as simulation,
        BagWriter(tmp_path / "bag", simulation, tmp_path / "missing.mp4") as bag,
    ):
        simulation.run([bag])
    content = json.loads((tmp_path / "bag" / foxglove.LAYOUT).read_text())
    assert not any(name.startswith("Image") for name in content["configById"])


def test_an_unreadable_film_is_refused(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"no film")
    with pytest.raises(InputError, match=r"film .*film\.mp4' cannot be read"):
        list(foxglove.pictures(path))
