"""The digest of kept drives covers what drives the truck, and nothing that only looks at it."""

from pathlib import Path

import iits_mj
from iits_mj.validation.harness.run_cache import NOT_DRIVING, driving_files


def test_every_excluded_package_exists():
    root = Path(iits_mj.__file__).parents[1]
    assert [name for name in NOT_DRIVING if not (root / name).is_dir()] == []


def test_planning_control_traffic_and_truck_are_covered_and_evaluation_is_not():
    folders = {name.rsplit("/", 1)[0] for name in driving_files()}
    assert folders >= {
        "controllers/planning",
        "controllers/tracking",
        "iits_mj/simulation",
        "iits_mj/parameters",
        "mjcf",
        "traffic_bridge",
    }
    assert not {"iits_mj/evaluation", "iits_mj/validation/planning"} & folders
