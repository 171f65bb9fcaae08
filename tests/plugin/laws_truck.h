// Parameters of a truck for programs that call the plugin's laws without MuJoCo.
#ifndef IITS_MJ_TESTS_PLUGIN_LAWS_TRUCK_H_
#define IITS_MJ_TESTS_PLUGIN_LAWS_TRUCK_H_

#include "plugin/laws/air_brake.h"
#include "plugin/laws/powertrain.h"
#include "plugin/laws/tire.h"

namespace iits {

template <class T>
Tire<T> MakeTire() {
  Tire<T> t;
  t.count = 2, t.free_radius = 0.5425, t.rolling_radius = 0.5267;
  t.vertical_stiffness = 1350e3, t.vertical_damping = 4000;
  t.cornering_coefficient = 5.8, t.pneumatic_trail = 0.045, t.nominal_load = 35e3;
  t.friction_lateral = 0.82, t.friction_longitudinal = 0.8, t.friction_load_slope = 0.08;
  t.shape_lateral = 1.35, t.shape_longitudinal = 1.6;
  t.curvature_lateral = -0.3, t.curvature_longitudinal = 0;
  t.load_saturation = 2.3, t.slip_stiffness = 11, t.rolling_resistance = 0.006;
  t.relaxation_lateral = 0.6, t.relaxation_load_exponent = 0.7, t.relaxation_longitudinal = 0.15;
  t.Prepare();
  return t;
}

template <class T>
Powertrain<T> MakePowertrain(bool adaptive) {
  Powertrain<T> p;
  Engine<T>& e = p.engine;
  e.idle_speed = 62.8, e.governed_speed = 219.9, e.governor_droop = 0.04;
  e.reference_torque = 2700, e.inertia = 2.21, e.pedal_up = 0.02, e.pedal_fade = 0.05;
  e.rise_rate = 300, e.rise_rate_low = 2000, e.rise_threshold = 220;
  e.fall_rate = 800, e.fall_rate_low = 3000, e.fall_threshold = 150, e.cut_time = 0.15;
  e.boost_lag = 0.4, e.spool_time = 3, e.idle_gain = 20, e.idle_integral_gain = 30;
  e.idle_band = 12, e.idle_integral_min = -100, e.idle_integral_max = 400;
  e.idle_forget_time = 0.2, e.sync_lag = 0.08, e.sync_torque_share = 0.3;
  e.sync_brake_share = 0.4, e.brake_power = 350e3, e.brake_speed = 240.9;
  e.brake_exponent = 1.4, e.brake_speed_min = 85, e.brake_fade = 20, e.brake_lag = 0.25;
  e.brake_release_lag = 0.05, e.idle_fuel_rate = 0.0006;
  e.full_load = {{62.8, 105, 167, 220}, {1400, 2580, 2450, 1870}};
  e.drag = {{104.7, 254.5}, {131, 200}};
  e.pedal_map = {{60, 220}, {0, 0.5, 1}, {0, 1900, 2600, 0, 50, 2600}};
  e.fuel_map = {{117, 1170, 2217},
                {73, 126, 188},
                {9.8e-8, 8.6e-8, 12e-8, 5.4e-8, 5.1e-8, 5.5e-8, 5.6e-8, 5.2e-8, 5.6e-8}};
  e.Prepare();
  p.retarder = {3500, 45, 550e3, 300e3, 14.8, 0.9, 0.35, 0.25};
  p.endurance = {0.02, 1};
  Gearbox<T>& b = p.gearbox;
  Gears<T>& g = b.gears;
  g.ratios = {11.67, 6, 3.2, 1.8, 1}, g.inertias = {0.15, 0.15, 0.15, 0.2, 0.46};
  g.efficiencies.assign(5, 0.98), g.driveline_efficiency = 0.95;
  g.reverse_ratio = 13, g.final_drive = 2.85, g.meters_per_radian = 0.52 / 2.85;
  b.cut_time = 0.15, b.synchronization_time = 0.4, b.synchronization_limit = 0.65;
  b.close_time = 0.15, b.synchronized_difference = 6;
  ShiftParameters<T>& s = b.strategy;
  s = {1,
       2,
       3,
       adaptive,
       0.7,
       0.15,
       40,
       0.5,
       0.55,
       1,
       5,
       0.25,
       0.4,
       2,
       1.15,
       0.6,
       1.7,
       1.5,
       1.3,
       1.5,
       0.6,
       1.05,
       1.2,
       0.92,
       2,
       1.08,
       1.05,
       1.03,
       1.12,
       0.9,
       0.85,
       0.15,
       1.5,
       1,
       0.7,
       0.95,
       0.3,
       0.95,
       0.45,
       0.93,
       0.8,
       0.1,
       1.1,
       0.03,
       0.75,
       30,
       1,
       0.92,
       {{1, 4}, {0, 1}, {2, 3, 12, 18}},
       {{2, 5}, {0, 1}, {1, 1.5, 7, 9}}};
  const T reduction = 2.85 * 2.85;
  p.driveline = {{62.8, 0.02, 2700. / 4000, 0.5, 0.1, 40, 3.8, 0.92, 1.05, 0.8, 0.1},
                 4000,
                 6e5 / reduction,
                 6e3 / reduction,
                 2};
  return p;
}

template <class T>
WheelBrake<T> MakeWheelBrake() {
  WheelBrake<T> w = {};
  w.dead_time = 0.05, w.build_up_time_constant = 0.2, w.release_time_constant = 0.14;
  w.torque_per_pressure = 0.0276, w.parking_torque = 9000, w.wheel_radius = 0.51;
  w.chamber_volume = 1.1e-3, w.circuit = kFront;
  w.push_out_pressure = 25e3, w.hysteresis_pressure = 15e3;
  w.abs_release_slip = 0.25, w.abs_reapply_slip = 0.05, w.abs_slip_lag = 0.01;
  w.abs_yaw_share = 1.5, w.abs_pressure_lag = 0.2, w.abs_refill_share = 0.9;
  w.abs_rise_time = 1, w.abs_slip_lead = 0.02, w.abs_speed_low = 5, w.abs_speed_min = 1.667;
  w.abs_time_constant = 0.08, w.abs_yaw_rise_rate = 100e3, w.stiffness = 4e5, w.inertia = 25;
  return w;
}

// Two wheels of the front circuit; Prepare still has to be called.
template <class T>
AirBrake<T> MakeAirBrake() {
  AirBrake<T> brake;
  brake.wheels = {MakeWheelBrake<T>(), MakeWheelBrake<T>()};
  brake.parking_time_constant = 0.3;
  brake.reservoirs = {{0.03, 0.03, 0.03}, 7.1e-5, 870e3, 1000e3, 480e3, 200e3};
  BrakeControl<T>& c = brake.control;
  c.rise_rate = c.fall_rate = 5e6, c.pressure_max = 850e3, c.release_rate = 5;
  c.pedal_deceleration = 10, c.rolling_resistance = 0, c.filter_time = 0.3, c.trim_gain = 0.8;
  c.trim_max = 0.4, c.trim_share = 0.3, c.trim_speed_min = 2;
  c.shaft_speed_off = 4.17, c.shaft_speed_on = 6.94, c.endurance_rate = 0.5;
  c.hysteresis = 15e3, c.hysteresis_time = 0.1, c.hold_speed = 0.3, c.hold_deceleration = 1.6;
  c.hold_release_speed = 1, c.hold_time_max = 5, c.hold_uphill = 0.05;
  BrakeDistribution<T>& d = c.distribution;
  d.demand = {0, 10}, d.light = d.heavy = {1, 0, 0, 1, 0, 0};
  d.mass_light = 9000, d.mass_heavy = 20000, d.push_out = 25e3;
  return brake;
}

}  // namespace iits

#endif  // IITS_MJ_TESTS_PLUGIN_LAWS_TRUCK_H_
