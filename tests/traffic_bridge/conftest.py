import pytest

from iits_mj.road import RoadMap, Route


@pytest.fixture(scope="session")
def straight():
    return Route.straight(length=4000.0)


@pytest.fixture(scope="session")
def highway():
    return RoadMap.builtin().route()


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IITS_MJ_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def _no_sumo_left_behind():
    yield
    from traffic_bridge.session import load_libsumo

    loaded = load_libsumo().isLoaded()
    if loaded:
        load_libsumo().close()
    assert not loaded, "the test left a SUMO simulation loaded"
