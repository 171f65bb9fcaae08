// Setting up of the air brake: attributes, wheels, actuators, the propeller shaft.
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "plugin/air_brake.h"
#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {

AirBrake* AirBrake::Create(const mjModel* m, int instance) {
  std::unique_ptr<AirBrake> b(new AirBrake());
  if (!b->FindActuators(m, instance) || !b->ReadWheels(m, instance) ||
      !b->FindJoints(m, instance) || !b->control_.Read(m, instance) ||
      !b->reservoirs_.Read(m, instance)) {
    return nullptr;
  }
  for (const WheelBrake& wheel : b->wheels_) {
    b->control_.AddWheel(wheel.circuit, wheel.wheel_radius, wheel.inertia,
                         wheel.torque_per_pressure);
    if (wheel.parking_torque > 0) b->spring_volume_[wheel.circuit] += wheel.chamber_volume;
  }
  b->ArrangeLines(m);
  b->FindShaft(m);
  return b->FindSensors(m, instance) ? b.release() : nullptr;
}

bool AirBrake::ReadWheels(const mjModel* m, int instance) {
  struct WheelAttribute {
    const char* name;
    double low, high;
    double WheelBrake::* member;
  };
  static const WheelAttribute kPerAxle[] = {
      {"dead_time", 0, 2, &WheelBrake::dead_time},
      {"build_up_time_constant", 0.001, 10, &WheelBrake::build_up_time_constant},
      {"release_time_constant", 0.001, 10, &WheelBrake::release_time_constant},
      {"torque_per_pressure", 0, 10, &WheelBrake::torque_per_pressure},
      {"parking_torque", 0, 1e6, &WheelBrake::parking_torque},
      {"wheel_radius", 0.05, 5, &WheelBrake::wheel_radius},
      {"chamber_volume", 0, 1, &WheelBrake::chamber_volume},
  };
  static const WheelAttribute kCommon[] = {
      {"push_out_pressure", 1, 1e6, &WheelBrake::push_out_pressure},
      {"hysteresis_pressure", 1, 1e6, &WheelBrake::hysteresis_pressure},
      {"abs_release_slip", 0.01, 1, &WheelBrake::abs_release_slip},
      {"abs_reapply_slip", 0, 1, &WheelBrake::abs_reapply_slip},
      {"abs_speed_min", 0.1, 100, &WheelBrake::abs_speed_min},
      {"abs_time_constant", 0.001, 10, &WheelBrake::abs_time_constant},
      {"abs_yaw_rise_rate", 1, 1e9, &WheelBrake::abs_yaw_rise_rate},
      {"abs_slip_lag", 0.001, 1, &WheelBrake::abs_slip_lag},
      {"abs_slip_lead", 0, 1, &WheelBrake::abs_slip_lead},
      {"abs_speed_low", 0.1, 100, &WheelBrake::abs_speed_low},
      {"stiffness", 1, 1e9, &WheelBrake::stiffness},
  };
  const std::vector<int> hubs = BodiesOfInstance(m, instance);
  const size_t axles = hubs.size() / 2;
  if (axles < 1 || axles > kAxlesMax || hubs.size() % 2) {
    mju_warning(
        "plugin instance '%s': %zu hub bodies reference it; allowed are 2 to %d, two an axle",
        InstanceName(m, instance).c_str(), hubs.size(), kWheelsMax);
    return false;
  }
  wheels_.resize(hubs.size());
  std::vector<double> circuit;
  if (!ReadNumbers(m, instance, "circuit", axles, axles, 0, kCircuits - 1, &circuit)) return false;
  for (const WheelAttribute& a : kPerAxle) {
    std::vector<double> values;
    if (!ReadNumbers(m, instance, a.name, axles, axles, a.low, a.high, &values)) return false;
    for (size_t i = 0; i < wheels_.size(); ++i) wheels_[i].*a.member = values[i / 2];
  }
  for (const WheelAttribute& a : kCommon) {
    double value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, &value)) return false;
    for (WheelBrake& wheel : wheels_) wheel.*a.member = value;
  }
  double trailer_delay;
  const Attribute lines[] = {
      {"trailer_line_delay", 0, 2, &trailer_delay},
      {"parking_time_constant", 0.001, 10, &parking_time_constant_},
  };
  if (!ReadAttributes(m, instance, lines)) return false;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    WheelBrake& wheel = wheels_[i];
    wheel.hub = hubs[i];
    wheel.circuit = static_cast<int>(circuit[i / 2]);
    if (wheel.circuit == kTrailer) wheel.dead_time += trailer_delay;
    if (wheel.abs_reapply_slip >= wheel.abs_release_slip) {
      mju_warning(
          "plugin instance '%s': attribute 'abs_reapply_slip' = %g must be less than "
          "abs_release_slip = %g",
          InstanceName(m, instance).c_str(), wheel.abs_reapply_slip, wheel.abs_release_slip);
      return false;
    }
  }
  return true;
}

bool AirBrake::FindJoints(const mjModel* m, int instance) {
  for (WheelBrake& wheel : wheels_) {
    wheel.dof = -1;
    int children = 0;
    for (int body = 1; body < m->nbody; ++body) {
      if (m->body_parentid[body] != wheel.hub) continue;
      ++children;
      int joint = m->body_jntadr[body];
      if (m->body_jntnum[body] == 1 && m->jnt_type[joint] == mjJNT_HINGE) {
        wheel.dof = m->jnt_dofadr[joint];
      }
    }
    if (wheel.dof < 0 || children != 1) {
      const char* name = mj_id2name(m, mjOBJ_BODY, wheel.hub);
      mju_warning("plugin instance '%s': hub body '%s' must have one child, a wheel on one hinge",
                  InstanceName(m, instance).c_str(), name ? name : "");
      return false;
    }
    wheel.inertia = m->dof_M0[wheel.dof];
  }
  return true;
}

void AirBrake::ArrangeLines(const mjModel* m) {
  double response = 0;
  for (const WheelBrake& wheel : wheels_) {
    dead_time_max_ = std::max(dead_time_max_, wheel.dead_time);
    response += (wheel.dead_time + wheel.build_up_time_constant) / wheels_.size();
    auto same = [&wheel](const Line& l) {
      return l.circuit == wheel.circuit && l.dead_time == wheel.dead_time;
    };
    auto place = std::find_if(lines_.begin(), lines_.end(), same);
    line_of_wheel_.push_back(static_cast<int>(place - lines_.begin()));
    if (place == lines_.end()) lines_.push_back({wheel.circuit, wheel.dead_time});
    rates_.push_back(wheel.Rates(m->opt.timestep));
  }
  sample_spacing_ = dead_time_max_ / (DeadTimeLine::kSlots - 2);
  control_.set_response_time(response);
}

bool AirBrake::FindActuators(const mjModel* m, int instance) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    std::string name = LocalName(mj_id2name(m, mjOBJ_ACTUATOR, i));
    int* slot = name == "xbr_demand"      ? &demand_
                : name == "xbr_mode"      ? &mode_
                : name == "parking_brake" ? &parking_
                : name == "brake_pedal"   ? &pedal_
                : name == "xbr_ebi_mode"  ? &ebi_mode_
                                          : nullptr;
    if (!slot || *slot >= 0) {
      mju_warning(
          "plugin instance '%s': actuator '%s' is not one of xbr_demand, xbr_mode, "
          "parking_brake, brake_pedal, xbr_ebi_mode, each at most once",
          InstanceName(m, instance).c_str(), name.c_str());
      return false;
    }
    *slot = i;
  }
  if (demand_ < 0 || mode_ < 0) {
    mju_warning("plugin instance '%s': needs the actuators xbr_demand and xbr_mode",
                InstanceName(m, instance).c_str());
    return false;
  }
  powertrain_ = PartnerInstance(m, demand_, "iits.powertrain");
  return true;
}

// The shaft's speed is the sum of the wheels' times their coefficients: the final drive.
void AirBrake::FindShaft(const mjModel* m) {
  if (powertrain_ < 0 || m->actuator_trntype[demand_] != mjTRN_TENDON) return;
  const int tendon = m->actuator_trnid[2 * demand_];
  const int begin = m->tendon_adr[tendon];
  for (int i = begin; i < begin + m->tendon_num[tendon]; ++i) {
    if (m->wrap_type[i] != mjWRAP_JOINT) continue;
    int dof = m->jnt_dofadr[m->wrap_objid[i]];
    for (const WheelBrake& wheel : wheels_) {
      if (wheel.dof == dof) shaft_ratio_ += m->wrap_prm[i] / wheel.wheel_radius;
    }
  }
}

}  // namespace iits
