"""The typed messages. `python tools/j1939_groups.py` makes them from `iits_mj.dbc`.

Numbers are in the units of the signals; a field that is left out says "not available".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from iits_mj.j1939.group import NOT_AVAILABLE, Group, Value


@dataclass(frozen=True, slots=True)
class XBR(Group):
    """XBR, PGN 1024 (0x0400).

    External brake request, to the brake controller.

    Attributes:
      external_acceleration_demand: [m/s2] SPN 2920.
      xbr_ebi_mode: SPN 2914.
      xbr_priority: SPN 2915.
      xbr_control_mode: SPN 2916.
      xbr_urgency: [%] SPN 4099.
      xbr_message_counter: SPN 3189.
      xbr_message_checksum: SPN 3188.
    """

    MESSAGE: ClassVar[str] = "XBR"

    external_acceleration_demand: Value = NOT_AVAILABLE
    xbr_ebi_mode: Value = NOT_AVAILABLE
    xbr_priority: Value = NOT_AVAILABLE
    xbr_control_mode: Value = NOT_AVAILABLE
    xbr_urgency: Value = NOT_AVAILABLE
    xbr_message_counter: Value = NOT_AVAILABLE
    xbr_message_checksum: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class TSC1(Group):
    """TSC1, PGN 0 (0x0000).

    Torque/speed control 1, here to a retarder: of the engine (address 15) or of the driveline (16).

    Attributes:
      override_control_mode: SPN 695.
      requested_speed_conditions: SPN 696.
      override_control_mode_priority: SPN 897.
      requested_speed_rpm: [rpm] SPN 898.
      requested_torque_percent: [%] SPN 518.
      transmission_rate: SPN 3349.
      control_purpose: SPN 3350.
      tsc1_message_counter: SPN 4206.
      tsc1_message_checksum: SPN 4207.
    """

    MESSAGE: ClassVar[str] = "TSC1"

    override_control_mode: Value = NOT_AVAILABLE
    requested_speed_conditions: Value = NOT_AVAILABLE
    override_control_mode_priority: Value = NOT_AVAILABLE
    requested_speed_rpm: Value = NOT_AVAILABLE
    requested_torque_percent: Value = NOT_AVAILABLE
    transmission_rate: Value = NOT_AVAILABLE
    control_purpose: Value = NOT_AVAILABLE
    tsc1_message_counter: Value = NOT_AVAILABLE
    tsc1_message_checksum: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EEC2(Group):
    """EEC2, PGN 61443 (0xF003).

    Electronic engine controller 2: accelerator pedal, load.

    Attributes:
      accelerator_pedal_low_idle_switch: SPN 558.
      accelerator_pedal_kickdown_switch: SPN 559.
      road_speed_limit_status: SPN 1437.
      accelerator_pedal_position_percent: [%] SPN 91.
      engine_percent_load_at_speed: [%] SPN 92.
      remote_accelerator_pedal_percent: [%] SPN 974.
      accelerator_pedal_2_position_percent: [%] SPN 29.
    """

    MESSAGE: ClassVar[str] = "EEC2"

    accelerator_pedal_low_idle_switch: Value = NOT_AVAILABLE
    accelerator_pedal_kickdown_switch: Value = NOT_AVAILABLE
    road_speed_limit_status: Value = NOT_AVAILABLE
    accelerator_pedal_position_percent: Value = NOT_AVAILABLE
    engine_percent_load_at_speed: Value = NOT_AVAILABLE
    remote_accelerator_pedal_percent: Value = NOT_AVAILABLE
    accelerator_pedal_2_position_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EEC1(Group):
    """EEC1, PGN 61444 (0xF004).

    Electronic engine controller 1: torque and speed.

    Attributes:
      engine_torque_mode: SPN 899.
      actual_engine_torque_fraction_percent: [%] SPN 4154.
      driver_demand_torque_percent: [%] SPN 512.
      actual_engine_torque_percent: [%] SPN 513.
      engine_speed_rpm: [rpm] SPN 190.
      engine_control_source_address: SPN 1483.
      engine_starter_mode: SPN 1675.
      engine_demand_torque_percent: [%] SPN 2432.
    """

    MESSAGE: ClassVar[str] = "EEC1"

    engine_torque_mode: Value = NOT_AVAILABLE
    actual_engine_torque_fraction_percent: Value = NOT_AVAILABLE
    driver_demand_torque_percent: Value = NOT_AVAILABLE
    actual_engine_torque_percent: Value = NOT_AVAILABLE
    engine_speed_rpm: Value = NOT_AVAILABLE
    engine_control_source_address: Value = NOT_AVAILABLE
    engine_starter_mode: Value = NOT_AVAILABLE
    engine_demand_torque_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EEC3(Group):
    """EEC3, PGN 65247 (0xFEDF).

    Electronic engine controller 3: losses.

    Attributes:
      nominal_friction_torque_percent: [%] SPN 514.
      desired_operating_speed_rpm: [rpm] SPN 515.
      operating_speed_asymmetry: SPN 519.
      estimated_parasitic_losses_percent: [%] SPN 2978.
    """

    MESSAGE: ClassVar[str] = "EEC3"

    nominal_friction_torque_percent: Value = NOT_AVAILABLE
    desired_operating_speed_rpm: Value = NOT_AVAILABLE
    operating_speed_asymmetry: Value = NOT_AVAILABLE
    estimated_parasitic_losses_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class ERC1(Group):
    """ERC1, PGN 61440 (0xF000).

    Electronic retarder controller 1, from the retarder of the engine (address 15) and of the
    driveline (16).

    Attributes:
      retarder_torque_mode: SPN 900.
      retarder_brake_assist_switch: SPN 571.
      retarder_shift_assist_switch: SPN 572.
      actual_retarder_torque_percent: [%] SPN 520.
      intended_retarder_torque_percent: [%] SPN 1085.
      engine_coolant_load_increase: SPN 1082.
      retarder_requesting_brake_light: SPN 1667.
      retarder_control_source_address: SPN 1480.
      driver_demand_retarder_torque_percent: [%] SPN 1715.
      retarder_selection_percent: [%] SPN 1716.
      available_retarder_torque_percent: [%] SPN 1717.
    """

    MESSAGE: ClassVar[str] = "ERC1"

    retarder_torque_mode: Value = NOT_AVAILABLE
    retarder_brake_assist_switch: Value = NOT_AVAILABLE
    retarder_shift_assist_switch: Value = NOT_AVAILABLE
    actual_retarder_torque_percent: Value = NOT_AVAILABLE
    intended_retarder_torque_percent: Value = NOT_AVAILABLE
    engine_coolant_load_increase: Value = NOT_AVAILABLE
    retarder_requesting_brake_light: Value = NOT_AVAILABLE
    retarder_control_source_address: Value = NOT_AVAILABLE
    driver_demand_retarder_torque_percent: Value = NOT_AVAILABLE
    retarder_selection_percent: Value = NOT_AVAILABLE
    available_retarder_torque_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class ETC1(Group):
    """ETC1, PGN 61442 (0xF002).

    Electronic transmission controller 1: shafts, clutch, shift in process.

    Attributes:
      driveline_engaged: SPN 560.
      torque_converter_lockup_engaged: SPN 573.
      shift_in_process: SPN 574.
      output_shaft_speed_rpm: [rpm] SPN 191.
      clutch_slip_percent: [%] SPN 522.
      momentary_engine_overspeed_enable: SPN 606.
      progressive_shift_disable: SPN 607.
      input_shaft_speed_rpm: [rpm] SPN 161.
      transmission_control_source_address: SPN 1482.
    """

    MESSAGE: ClassVar[str] = "ETC1"

    driveline_engaged: Value = NOT_AVAILABLE
    torque_converter_lockup_engaged: Value = NOT_AVAILABLE
    shift_in_process: Value = NOT_AVAILABLE
    output_shaft_speed_rpm: Value = NOT_AVAILABLE
    clutch_slip_percent: Value = NOT_AVAILABLE
    momentary_engine_overspeed_enable: Value = NOT_AVAILABLE
    progressive_shift_disable: Value = NOT_AVAILABLE
    input_shaft_speed_rpm: Value = NOT_AVAILABLE
    transmission_control_source_address: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class ETC2(Group):
    """ETC2, PGN 61445 (0xF005).

    Electronic transmission controller 2: gears.

    Attributes:
      selected_gear: SPN 524.
      actual_gear_ratio: SPN 526.
      current_gear: SPN 523.
      requested_range: SPN 162.
      current_range: SPN 163.
    """

    MESSAGE: ClassVar[str] = "ETC2"

    selected_gear: Value = NOT_AVAILABLE
    actual_gear_ratio: Value = NOT_AVAILABLE
    current_gear: Value = NOT_AVAILABLE
    requested_range: Value = NOT_AVAILABLE
    current_range: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class CCVS1(Group):
    """CCVS1, PGN 65265 (0xFEF1).

    Cruise control / vehicle speed 1: speed of the drive axles, brake switches.

    Attributes:
      two_speed_axle_switch: SPN 69.
      parking_brake_switch: SPN 70.
      cruise_pause_switch: SPN 1633.
      wheel_based_speed_kph: [km/h] SPN 84.
      cruise_active: SPN 595.
      cruise_enable_switch: SPN 596.
      brake_switch: SPN 597.
      clutch_switch: SPN 598.
      cruise_set_speed_kph: [km/h] SPN 86.
      pto_state: SPN 976.
      cruise_states: SPN 527.
    """

    MESSAGE: ClassVar[str] = "CCVS1"

    two_speed_axle_switch: Value = NOT_AVAILABLE
    parking_brake_switch: Value = NOT_AVAILABLE
    cruise_pause_switch: Value = NOT_AVAILABLE
    wheel_based_speed_kph: Value = NOT_AVAILABLE
    cruise_active: Value = NOT_AVAILABLE
    cruise_enable_switch: Value = NOT_AVAILABLE
    brake_switch: Value = NOT_AVAILABLE
    clutch_switch: Value = NOT_AVAILABLE
    cruise_set_speed_kph: Value = NOT_AVAILABLE
    pto_state: Value = NOT_AVAILABLE
    cruise_states: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EBC1(Group):
    """EBC1, PGN 61441 (0xF001).

    Electronic brake controller 1: pedal, ABS.

    Attributes:
      asr_engine_control_active: SPN 561.
      asr_brake_control_active: SPN 562.
      abs_active: SPN 563.
      ebs_brake_switch: SPN 1121.
      brake_pedal_position_percent: [%] SPN 521.
      engine_retarder_selection_percent: [%] SPN 973.
      abs_fully_operational: SPN 1243.
      brake_control_source_address: SPN 1481.
      trailer_abs_status: SPN 1836.
    """

    MESSAGE: ClassVar[str] = "EBC1"

    asr_engine_control_active: Value = NOT_AVAILABLE
    asr_brake_control_active: Value = NOT_AVAILABLE
    abs_active: Value = NOT_AVAILABLE
    ebs_brake_switch: Value = NOT_AVAILABLE
    brake_pedal_position_percent: Value = NOT_AVAILABLE
    engine_retarder_selection_percent: Value = NOT_AVAILABLE
    abs_fully_operational: Value = NOT_AVAILABLE
    brake_control_source_address: Value = NOT_AVAILABLE
    trailer_abs_status: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EBC2(Group):
    """EBC2, PGN 65215 (0xFEBF).

    Electronic brake controller 2: wheel speeds of the tractor.

    Attributes:
      front_axle_speed_kph: [km/h] SPN 904.
      relative_speed_front_left_kph: [km/h] SPN 905.
      relative_speed_front_right_kph: [km/h] SPN 906.
      relative_speed_rear1_left_kph: [km/h] SPN 907.
      relative_speed_rear1_right_kph: [km/h] SPN 908.
      relative_speed_rear2_left_kph: [km/h] SPN 909.
      relative_speed_rear2_right_kph: [km/h] SPN 910.
    """

    MESSAGE: ClassVar[str] = "EBC2"

    front_axle_speed_kph: Value = NOT_AVAILABLE
    relative_speed_front_left_kph: Value = NOT_AVAILABLE
    relative_speed_front_right_kph: Value = NOT_AVAILABLE
    relative_speed_rear1_left_kph: Value = NOT_AVAILABLE
    relative_speed_rear1_right_kph: Value = NOT_AVAILABLE
    relative_speed_rear2_left_kph: Value = NOT_AVAILABLE
    relative_speed_rear2_right_kph: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EBC3(Group):
    """EBC3, PGN 65197 (0xFEAD).

    Electronic brake controller 3: brake application pressures of the tractor.

    Attributes:
      brake_pressure_front_left_kpa: [kPa] SPN 1091.
      brake_pressure_front_right_kpa: [kPa] SPN 1092.
      brake_pressure_rear1_left_kpa: [kPa] SPN 1093.
      brake_pressure_rear1_right_kpa: [kPa] SPN 1094.
      brake_pressure_rear2_left_kpa: [kPa] SPN 1095.
      brake_pressure_rear2_right_kpa: [kPa] SPN 1096.
      brake_pressure_rear3_left_kpa: [kPa] SPN 1097.
      brake_pressure_rear3_right_kpa: [kPa] SPN 1098.
    """

    MESSAGE: ClassVar[str] = "EBC3"

    brake_pressure_front_left_kpa: Value = NOT_AVAILABLE
    brake_pressure_front_right_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear1_left_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear1_right_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear2_left_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear2_right_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear3_left_kpa: Value = NOT_AVAILABLE
    brake_pressure_rear3_right_kpa: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EBC5(Group):
    """EBC5, PGN 64964 (0xFDC4).

    Electronic brake controller 5: state and limit of XBR.

    Attributes:
      brake_temperature_warning: SPN 3839.
      halt_brake_mode: SPN 2912.
      hill_holder_mode: SPN 2913.
      foundation_brake_use: SPN 2919.
      xbr_system_state: SPN 2917.
      xbr_active_control_mode: SPN 2918.
      xbr_acceleration_limit: [m/s2] SPN 2921.
    """

    MESSAGE: ClassVar[str] = "EBC5"

    brake_temperature_warning: Value = NOT_AVAILABLE
    halt_brake_mode: Value = NOT_AVAILABLE
    hill_holder_mode: Value = NOT_AVAILABLE
    foundation_brake_use: Value = NOT_AVAILABLE
    xbr_system_state: Value = NOT_AVAILABLE
    xbr_active_control_mode: Value = NOT_AVAILABLE
    xbr_acceleration_limit: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class VDC2(Group):
    """VDC2, PGN 61449 (0xF009).

    Vehicle dynamic stability control 2.

    Attributes:
      steering_wheel_angle: [rad] SPN 1807.
      steering_wheel_turn_counter: SPN 1811.
      steering_wheel_angle_sensor_type: SPN 1812.
      yaw_rate: [rad/s] SPN 1808.
      lateral_acceleration: [m/s2] SPN 1809.
      longitudinal_acceleration: [m/s2] SPN 1810.
    """

    MESSAGE: ClassVar[str] = "VDC2"

    steering_wheel_angle: Value = NOT_AVAILABLE
    steering_wheel_turn_counter: Value = NOT_AVAILABLE
    steering_wheel_angle_sensor_type: Value = NOT_AVAILABLE
    yaw_rate: Value = NOT_AVAILABLE
    lateral_acceleration: Value = NOT_AVAILABLE
    longitudinal_acceleration: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class LFE1(Group):
    """LFE1, PGN 65266 (0xFEF2).

    Fuel economy (liquid).

    Attributes:
      engine_fuel_rate_l_per_h: [L/h] SPN 183.
      instantaneous_fuel_economy_km_per_l: [km/L] SPN 184.
      average_fuel_economy_km_per_l: [km/L] SPN 185.
      throttle_position_percent: [%] SPN 51.
    """

    MESSAGE: ClassVar[str] = "LFE1"

    engine_fuel_rate_l_per_h: Value = NOT_AVAILABLE
    instantaneous_fuel_economy_km_per_l: Value = NOT_AVAILABLE
    average_fuel_economy_km_per_l: Value = NOT_AVAILABLE
    throttle_position_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class HRLFC(Group):
    """HRLFC, PGN 64777 (0xFD09).

    High resolution fuel consumption (liquid).

    Attributes:
      trip_fuel_l: [L] SPN 5053.
      total_fuel_used_l: [L] SPN 5054.
    """

    MESSAGE: ClassVar[str] = "HRLFC"

    trip_fuel_l: Value = NOT_AVAILABLE
    total_fuel_used_l: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class AIR1(Group):
    """AIR1, PGN 65198 (0xFEAE).

    Air supply pressure.

    Attributes:
      pneumatic_supply_pressure_kpa: [kPa] SPN 46.
      parking_and_trailer_pressure_kpa: [kPa] SPN 1086.
      service_circuit_1_pressure_kpa: [kPa] SPN 1087.
      service_circuit_2_pressure_kpa: [kPa] SPN 1088.
      auxiliary_equipment_pressure_kpa: [kPa] SPN 1089.
      air_suspension_pressure_kpa: [kPa] SPN 1090.
      compressor_status: SPN 1351.
    """

    MESSAGE: ClassVar[str] = "AIR1"

    pneumatic_supply_pressure_kpa: Value = NOT_AVAILABLE
    parking_and_trailer_pressure_kpa: Value = NOT_AVAILABLE
    service_circuit_1_pressure_kpa: Value = NOT_AVAILABLE
    service_circuit_2_pressure_kpa: Value = NOT_AVAILABLE
    auxiliary_equipment_pressure_kpa: Value = NOT_AVAILABLE
    air_suspension_pressure_kpa: Value = NOT_AVAILABLE
    compressor_status: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class VW(Group):
    """VW, PGN 65258 (0xFEEA).

    Vehicle weight, one frame an axle (location: axle from the front in the high nibble).

    Attributes:
      axle_location: SPN 928.
      axle_weight_kg: [kg] SPN 582.
      trailer_weight_kg: [kg] SPN 180.
      cargo_weight_kg: [kg] SPN 181.
    """

    MESSAGE: ClassVar[str] = "VW"

    axle_location: Value = NOT_AVAILABLE
    axle_weight_kg: Value = NOT_AVAILABLE
    trailer_weight_kg: Value = NOT_AVAILABLE
    cargo_weight_kg: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class EC1(Group):
    """EC1, PGN 65251 (0xFEE3).

    Engine configuration 1, a long message: torque curve (point 1 idle, 6 high idle), reference
    torque.

    Attributes:
      engine_speed_point_1_rpm: [rpm] SPN 188.
      engine_torque_point_1_percent: [%] SPN 539.
      engine_speed_point_2_rpm: [rpm] SPN 528.
      engine_torque_point_2_percent: [%] SPN 540.
      engine_speed_point_3_rpm: [rpm] SPN 529.
      engine_torque_point_3_percent: [%] SPN 541.
      engine_speed_point_4_rpm: [rpm] SPN 530.
      engine_torque_point_4_percent: [%] SPN 542.
      engine_speed_point_5_rpm: [rpm] SPN 531.
      engine_torque_point_5_percent: [%] SPN 543.
      engine_speed_point_6_rpm: [rpm] SPN 532.
      governor_gain_percent_per_rpm: [%/rpm] SPN 545.
      reference_engine_torque_nm: [N m] SPN 544.
      override_speed_point_7_rpm: [rpm] SPN 533.
      override_time_limit_s: [s] SPN 534.
      speed_control_lower_limit_rpm: [rpm] SPN 535.
      speed_control_upper_limit_rpm: [rpm] SPN 536.
      torque_control_lower_limit_percent: [%] SPN 537.
      torque_control_upper_limit_percent: [%] SPN 538.
      extended_speed_control_upper_limit_rpm: [rpm] SPN 1712.
      engine_moment_of_inertia_kg_m2: [kg m2] SPN 1794.
      default_torque_limit_nm: [N m] SPN 1846.
    """

    MESSAGE: ClassVar[str] = "EC1"

    engine_speed_point_1_rpm: Value = NOT_AVAILABLE
    engine_torque_point_1_percent: Value = NOT_AVAILABLE
    engine_speed_point_2_rpm: Value = NOT_AVAILABLE
    engine_torque_point_2_percent: Value = NOT_AVAILABLE
    engine_speed_point_3_rpm: Value = NOT_AVAILABLE
    engine_torque_point_3_percent: Value = NOT_AVAILABLE
    engine_speed_point_4_rpm: Value = NOT_AVAILABLE
    engine_torque_point_4_percent: Value = NOT_AVAILABLE
    engine_speed_point_5_rpm: Value = NOT_AVAILABLE
    engine_torque_point_5_percent: Value = NOT_AVAILABLE
    engine_speed_point_6_rpm: Value = NOT_AVAILABLE
    governor_gain_percent_per_rpm: Value = NOT_AVAILABLE
    reference_engine_torque_nm: Value = NOT_AVAILABLE
    override_speed_point_7_rpm: Value = NOT_AVAILABLE
    override_time_limit_s: Value = NOT_AVAILABLE
    speed_control_lower_limit_rpm: Value = NOT_AVAILABLE
    speed_control_upper_limit_rpm: Value = NOT_AVAILABLE
    torque_control_lower_limit_percent: Value = NOT_AVAILABLE
    torque_control_upper_limit_percent: Value = NOT_AVAILABLE
    extended_speed_control_upper_limit_rpm: Value = NOT_AVAILABLE
    engine_moment_of_inertia_kg_m2: Value = NOT_AVAILABLE
    default_torque_limit_nm: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class RC(Group):
    """RC, PGN 65249 (0xFEE1).

    Retarder configuration, a long message: torque curve (point 1 idle, 2 greatest speed, 5 peak
    torque), reference torque.

    Attributes:
      retarder_type: SPN 901.
      retarder_location: SPN 902.
      retarder_control_steps: SPN 557.
      retarder_speed_point_1_rpm: [rpm] SPN 546.
      retarder_torque_point_1_percent: [%] SPN 551.
      retarder_speed_point_2_rpm: [rpm] SPN 548.
      retarder_torque_point_2_percent: [%] SPN 552.
      retarder_speed_point_3_rpm: [rpm] SPN 549.
      retarder_torque_point_3_percent: [%] SPN 553.
      retarder_speed_point_4_rpm: [rpm] SPN 550.
      retarder_torque_point_4_percent: [%] SPN 554.
      retarder_speed_point_5_rpm: [rpm] SPN 547.
      reference_retarder_torque_nm: [N m] SPN 556.
      retarder_torque_point_5_percent: [%] SPN 555.
    """

    MESSAGE: ClassVar[str] = "RC"

    retarder_type: Value = NOT_AVAILABLE
    retarder_location: Value = NOT_AVAILABLE
    retarder_control_steps: Value = NOT_AVAILABLE
    retarder_speed_point_1_rpm: Value = NOT_AVAILABLE
    retarder_torque_point_1_percent: Value = NOT_AVAILABLE
    retarder_speed_point_2_rpm: Value = NOT_AVAILABLE
    retarder_torque_point_2_percent: Value = NOT_AVAILABLE
    retarder_speed_point_3_rpm: Value = NOT_AVAILABLE
    retarder_torque_point_3_percent: Value = NOT_AVAILABLE
    retarder_speed_point_4_rpm: Value = NOT_AVAILABLE
    retarder_torque_point_4_percent: Value = NOT_AVAILABLE
    retarder_speed_point_5_rpm: Value = NOT_AVAILABLE
    reference_retarder_torque_nm: Value = NOT_AVAILABLE
    retarder_torque_point_5_percent: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class CVW(Group):
    """CVW, PGN 65136 (0xFE70).

    Combination vehicle weight: of the tractor and of all.

    Attributes:
      powered_vehicle_weight_kg: [kg] SPN 1585.
      gross_combination_weight_kg: [kg] SPN 1760.
    """

    MESSAGE: ClassVar[str] = "CVW"

    powered_vehicle_weight_kg: Value = NOT_AVAILABLE
    gross_combination_weight_kg: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsCommand(Group):
    """IITS_COMMAND, PGN 65280 (0xFF00).

    Our own (proprietary B): what a driver does: steering wheel, brake pedal, parking brake and
    gear selector.

    Attributes:
      steering_wheel_angle_request: [rad] our own.
      steering_control_mode: our own.
      parking_brake_request: our own.
      transmission_mode_request: our own.
      driver_brake_pedal_percent: [%] our own.
      command_message_counter: our own.
      command_message_checksum: our own.
    """

    MESSAGE: ClassVar[str] = "IITS_COMMAND"

    steering_wheel_angle_request: Value = NOT_AVAILABLE
    steering_control_mode: Value = NOT_AVAILABLE
    parking_brake_request: Value = NOT_AVAILABLE
    transmission_mode_request: Value = NOT_AVAILABLE
    driver_brake_pedal_percent: Value = NOT_AVAILABLE
    command_message_counter: Value = NOT_AVAILABLE
    command_message_checksum: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsTrailer(Group):
    """IITS_TRAILER, PGN 65281 (0xFF01).

    Our own (proprietary B): articulation and trailer.

    Attributes:
      articulation: [rad] our own.
      articulation_rate: [rad/s] our own.
      trailer_yaw_rate: [rad/s] our own.
      brake_pressure_trailer_kpa: [kPa] our own.
    """

    MESSAGE: ClassVar[str] = "IITS_TRAILER"

    articulation: Value = NOT_AVAILABLE
    articulation_rate: Value = NOT_AVAILABLE
    trailer_yaw_rate: Value = NOT_AVAILABLE
    brake_pressure_trailer_kpa: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsPose(Group):
    """IITS_POSE, PGN 65282 (0xFF02).

    Our own (proprietary B): position of the steer axle centre in the map.

    Attributes:
      position_x: [m] our own.
      position_y: [m] our own.
    """

    MESSAGE: ClassVar[str] = "IITS_POSE"

    position_x: Value = NOT_AVAILABLE
    position_y: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsAttitude(Group):
    """IITS_ATTITUDE, PGN 65283 (0xFF03).

    Our own (proprietary B): attitude and height.

    Attributes:
      yaw: [rad] our own.
      pitch: [rad] our own.
      roll: [rad] our own.
      position_z: [m] our own.
    """

    MESSAGE: ClassVar[str] = "IITS_ATTITUDE"

    yaw: Value = NOT_AVAILABLE
    pitch: Value = NOT_AVAILABLE
    roll: Value = NOT_AVAILABLE
    position_z: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsRoute(Group):
    """IITS_ROUTE, PGN 65284 (0xFF04).

    Our own (proprietary B): route coordinates.

    Attributes:
      station: [m] our own.
      route_offset: [m] our own.
      trailer_route_offset: [m] our own.
    """

    MESSAGE: ClassVar[str] = "IITS_ROUTE"

    station: Value = NOT_AVAILABLE
    route_offset: Value = NOT_AVAILABLE
    trailer_route_offset: Value = NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class IitsMotion(Group):
    """IITS_MOTION, PGN 65285 (0xFF05).

    Our own (proprietary B): velocity of the steer axle centre and road-wheel angle.

    Attributes:
      forward_speed: [m/s] our own.
      lateral_speed: [m/s] our own.
      forward_acceleration: [m/s2] our own.
      road_wheel_angle: [rad] our own.
    """

    MESSAGE: ClassVar[str] = "IITS_MOTION"

    forward_speed: Value = NOT_AVAILABLE
    lateral_speed: Value = NOT_AVAILABLE
    forward_acceleration: Value = NOT_AVAILABLE
    road_wheel_angle: Value = NOT_AVAILABLE
