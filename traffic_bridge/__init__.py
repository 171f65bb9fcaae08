"""Traffic around the truck: SUMO simulations, recordings and data sets, shown in MuJoCo.

    from traffic_bridge import InterSim, TrafficConfig

    with InterSim(route, TrafficConfig(density="medium", speed_limit=15.0), seed=0) as traffic:
        vehicles = traffic.reset(ego)
        vehicles = traffic.step(ego)      # every 0.1 s

The modes are PureSim, InterSim, EventSim, RepSim, ReSim and MixedSim; `docs/traffic.md` describes
them.
libsumo is imported when a simulation starts.
"""

from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.config import Departure, TrafficConfig
from traffic_bridge.datasets import (
    ImportConfig,
    Trajectories,
    import_trajectories,
    read_trajectories,
)
from traffic_bridge.mirror.mirror import Mirror
from traffic_bridge.modes.event_sim import EventSim
from traffic_bridge.modes.parallel import SeparateTraffic, TrafficWorlds, WorldSpec
from traffic_bridge.modes.repsim import MixedSim, RepSim
from traffic_bridge.modes.resim import ReSim
from traffic_bridge.modes.sumo_modes import InterSim, PureSim, Traffic
from traffic_bridge.network.map_network import MapNetwork
from traffic_bridge.network.nets import build_network, cache_dir, find_netconvert
from traffic_bridge.own_traffic import TRAFFIC, OwnTraffic, TrafficSource, vehicle_on
from traffic_bridge.recording.recorder import Recorder
from traffic_bridge.recording.recording import PoseDigest, Recording
from traffic_bridge.scenario.actions import (
    ActivateDriver,
    Brake,
    BrakeLeak,
    ChangeLane,
    ChangeSpeed,
    CrossRoad,
    CutIn,
    Drift,
    EndDrive,
    FollowPath,
    FollowSpeeds,
    FrictionChange,
    KeepDistance,
    LoseCargo,
    Milestone,
    PlaceVehicle,
    Puncture,
    RemoveVehicle,
    SetValue,
    StuckSpeedSensor,
    Swarm,
    Swerve,
    Synchronize,
    Teleport,
    Wind,
)
from traffic_bridge.scenario.conditions import Condition
from traffic_bridge.scenario.reading import read_events
from traffic_bridge.scenario.runner import EventRecord, Scenario
from traffic_bridge.session import sumo_runs_here
from traffic_bridge.signals.events import (
    LaneClosure,
    LightOverride,
    LightProgramRun,
    SlowConvoy,
    SpeedLimit,
    StoppedVehicle,
    VehicleChange,
)
from traffic_bridge.signals.lights import LightAhead, LightPhase
from traffic_bridge.vehicles.calibration import (
    Calibration,
    calibrate,
    calibrate_each,
    calibrate_headways,
    calibrated_types,
    evaluate,
    trimmed,
)
from traffic_bridge.vehicles.idm import IdmParameters
from traffic_bridge.vehicles.types import (
    KINDS,
    VehicleType,
    default_types,
    motorway_types,
    read_types,
)

__all__ = [
    "KINDS",
    "TRAFFIC",
    "ActivateDriver",
    "Brake",
    "BrakeLeak",
    "Calibration",
    "ChangeLane",
    "ChangeSpeed",
    "Condition",
    "CrossRoad",
    "CutIn",
    "Departure",
    "Drift",
    "EndDrive",
    "EventRecord",
    "EventSim",
    "FollowPath",
    "FollowSpeeds",
    "FrictionChange",
    "IdmParameters",
    "ImportConfig",
    "InterSim",
    "KeepDistance",
    "LaneClosure",
    "LightAhead",
    "LightOverride",
    "LightPhase",
    "LightProgramRun",
    "LoseCargo",
    "MapNetwork",
    "Milestone",
    "Mirror",
    "MixedSim",
    "OwnTraffic",
    "PlaceVehicle",
    "PoseDigest",
    "Puncture",
    "PureSim",
    "ReSim",
    "Recorder",
    "Recording",
    "RemoveVehicle",
    "RepSim",
    "Scenario",
    "SeparateTraffic",
    "SetValue",
    "SlowConvoy",
    "SpeedLimit",
    "StoppedVehicle",
    "StuckSpeedSensor",
    "Swarm",
    "Swerve",
    "Synchronize",
    "Teleport",
    "Traffic",
    "TrafficConfig",
    "TrafficSource",
    "TrafficWorlds",
    "Trajectories",
    "VehicleChange",
    "VehicleFrame",
    "VehicleType",
    "Wind",
    "WorldSpec",
    "build_network",
    "cache_dir",
    "calibrate",
    "calibrate_each",
    "calibrate_headways",
    "calibrated_types",
    "default_types",
    "evaluate",
    "find_netconvert",
    "import_trajectories",
    "motorway_types",
    "read_events",
    "read_trajectories",
    "read_types",
    "sumo_runs_here",
    "trimmed",
    "vehicle_on",
]
