// Tire plugin `iits.tire`. Wheel bodies reference the instance; the road is the plane z = 0, or a
// table in a custom numeric of the model named `iits_road`, also in an attached model:
// it is stored in mjModel, once for all mjData.
#include "plugin/laws/tire.h"

#include <algorithm>
#include <cstring>
#include <string>

#include "plugin/laws/road.h"
#include "plugin/parts.h"
#include "plugin/plugin.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

class TirePlugin : public PluginBase {
 public:
  using State = TireState;  // of one wheel

  static int StateCount(const mjModel* m, int instance) {
    return static_cast<int>(BodiesOfInstance(m, instance).size());
  }

  // Forces are (Fx, Fy, Fz), slips are (longitudinal slip, slip angle).
  static int SensorSize(const mjModel* m, int, int sensor) {
    return ReadsSlip(m, sensor) ? kSlipSize : kForceSize;
  }

  Attributes Table() {
    Tire<double>& t = law_;
    return {
        Number("count", 1, 2, &t.count),
        Number("free_radius", 0.05, 5, &t.free_radius),
        Number("rolling_radius", 0.05, 5, &t.rolling_radius),
        Number("vertical_stiffness", 1e3, 1e8, &t.vertical_stiffness),
        Number("vertical_damping", 0, 1e6, &t.vertical_damping),
        Number("cornering_coefficient", 0.1, 50, &t.cornering_coefficient),
        Number("pneumatic_trail", 0, 0.5, &t.pneumatic_trail),
        Number("nominal_load", 100, 1e6, &t.nominal_load),
        Number("friction_lateral", 0.01, 3, &t.friction_lateral),
        Number("friction_longitudinal", 0.01, 3, &t.friction_longitudinal),
        Number("friction_load_slope", 0, 0.5, &t.friction_load_slope),
        Number("shape_lateral", 1, 2, &t.shape_lateral),
        Number("shape_longitudinal", 1, 2, &t.shape_longitudinal),
        Number("curvature_lateral", -10, 1, &t.curvature_lateral),
        Number("curvature_longitudinal", -10, 1, &t.curvature_longitudinal),
        Number("load_saturation", 0.5, 20, &t.load_saturation),
        Number("slip_stiffness", 1, 100, &t.slip_stiffness),
        Number("relaxation_lateral", 0.05, 5, &t.relaxation_lateral),
        Number("relaxation_load_exponent", 0, 2, &t.relaxation_load_exponent),
        Number("relaxation_longitudinal", 0.05, 5, &t.relaxation_longitudinal),
        Number("rolling_resistance", 0, 0.2, &t.rolling_resistance),
        Optional(Number("rolling_resistance_load", 100, 1e6, &t.rolling_resistance_load)),
        Together("rolling_resistance_load",
                 Number("rolling_resistance_exponent", 0.1, 2, &t.rolling_resistance_exponent)),
    };
  }

  bool Bind(const mjModel* m, int instance) {
    if (!ReadAttributes(m, instance, Table())) return false;
    law_.Prepare();
    for (int body : BodiesOfInstance(m, instance)) {
      const int joint = m->body_jntadr[body];
      if (m->body_jntnum[body] != 1 || m->jnt_type[joint] != mjJNT_HINGE) {
        return Refuse(m, instance, "wheel body '%s' must have exactly one hinge joint",
                      m->names + m->name_bodyadr[body]);
      }
      const int dof = m->jnt_dofadr[joint];
      wheels_.push_back(
          {body, m->body_parentid[body], m->body_rootid[body], dof, law_.Carry(m->dof_M0[dof])});
      common_dof_ = wheels_.size() == 1 ? dof : CommonDof(m, common_dof_, dof);
    }
    return FindSensors(m, instance) && FindRoad(m, instance);
  }

  void Reset(State* states) const {
    for (size_t i = 0; i < wheels_.size(); ++i) {
      states[i].station = states[i].next_station = RoadTable::kUnknownStation;
    }
  }

  // One pass, two wheels at a time. A wheel's wrench acts on its own degrees of freedom; the sum of
  // all wrenches acts on the common ones, with less than half of the products.
  void Passive(const mjModel* m, mjData* d, State* states) const {
    const int count = static_cast<int>(wheels_.size());
    Wrench sum;
    for (int i = 0; i < count; i += 2) {
      const int j =
          std::min(i + 1, count - 1);  // the last of an odd number of wheels: a pair of one
      Wrench wrench[2];
      PairForces(m, d, wheels_[i], wheels_[j], states + i, states + j, wrench);
      for (int k = i; k <= j; ++k) {
        wrench[k - i].Project(m, d, wheels_[k].dof, common_dof_, d->qfrc_passive);
        sum.Add(wrench[k - i]);
      }
    }
    if (common_dof_ >= 0) sum.Project(m, d, common_dof_, -1, d->qfrc_passive);
  }

  void Sensors(const mjModel*, mjData* d, const State* states) const {
    for (const Sensor& sensor : sensors_) {
      const double* signal = states[sensor.wheel].signal + sensor.first;
      std::copy(signal, signal + sensor.size, d->sensordata + sensor.address);
    }
  }

  void Advance(const mjModel*, mjData*, State* states) const {
    for (size_t i = 0; i < wheels_.size(); ++i) {
      states[i].bristles = states[i].next_bristles;
      states[i].station = states[i].next_station;
    }
  }

  TirePart Part() const { return {&law_, road_, road_address_}; }

 private:
  // Sizes of the sensors, and index of the slips in the state's signals.
  static constexpr int kForceSize = 3, kSlipSize = 2, kSlipFirst = 4;

  struct Wheel {
    int body, hub, root, dof;
    double carry;
  };
  struct Sensor {
    int address, wheel, first, size;
  };

  static bool ReadsSlip(const mjModel* m, int sensor) {
    return std::strstr(m->names + m->name_sensoradr[sensor], "_tire_slip");
  }

  bool FindSensors(const mjModel* m, int instance) {
    for (int i : SensorsOfInstance(m, instance)) {
      auto wheel = std::find_if(wheels_.begin(), wheels_.end(), [m, i](const Wheel& w) {
        return m->sensor_objtype[i] == mjOBJ_BODY && m->sensor_objid[i] == w.body;
      });
      if (wheel == wheels_.end()) {
        return Refuse(m, instance, "sensor '%s' needs objtype='body' and one of its wheels",
                      m->names + m->name_sensoradr[i]);
      }
      const bool slip = ReadsSlip(m, i);
      sensors_.push_back({m->sensor_adr[i], static_cast<int>(wheel - wheels_.begin()),
                          slip ? kSlipFirst : 0, slip ? kSlipSize : kForceSize});
    }
    return true;
  }

  // The numeric is: version, row count, station of row 0 [m], step [m], then the rows. In version 2
  // the unevenness follows: rows and columns, steps along and across [m], then the heights [m].
  bool FindRoad(const mjModel* m, int instance) {
    constexpr int kHeader = 4;
    for (int i = 0; i < m->nnumeric; ++i) {
      if (!std::strstr(m->names + m->name_numericadr[i], "iits_road")) continue;
      const double* data = m->numeric_data + m->numeric_adr[i];
      const int size = m->numeric_size[i];
      bool valid = size >= kHeader && (data[0] == 1 || data[0] == 2) && data[1] >= 2 &&
                   data[1] < size && data[3] > 0;
      const int count = valid ? static_cast<int>(data[1]) : 0;
      const int header = valid && data[0] == 2 ? 2 * kHeader : kHeader;
      if (!valid || !(size >= header)) return RefuseRoad(m, instance, size);
      road_ = {count, data[2], data[3], 1 / data[3]};
      double heights = 0;
      if (header > kHeader) {
        const double rows = data[4], columns = data[5];
        heights = rows * columns;
        valid = rows >= 4 && rows < size && columns >= 2 && columns < size && data[6] > 0 &&
                data[7] > 0;
        if (!valid) return RefuseRoad(m, instance, size);
        road_.grid_rows = static_cast<int>(rows);
        road_.grid_columns = static_cast<int>(columns);
        road_.grid_along = data[6];
        road_.grid_across = data[7];
      }
      if (size != header + 1. * RoadTable::kColumns * count + heights) {
        return RefuseRoad(m, instance, size);
      }
      road_address_ = m->numeric_adr[i] + header;
      return true;
    }
    return true;
  }

  static bool RefuseRoad(const mjModel* m, int instance, int size) {
    return Refuse(m, instance, "numeric 'iits_road' (%d numbers) is not a road table", size);
  }

  // Wrenches on two wheels, and their next states.
  void PairForces(const mjModel* m, const mjData* d, const Wheel& a, const Wheel& b, State* sa,
                  State* sb, Wrench wrenches[2]) const {
    // Three components each, from two places.
    auto gather = [](const mjtNum* x, const mjtNum* y, int stride, Pair out[3]) {
      for (int i = 0; i < 3; ++i) out[i] = Pair{x[i * stride], y[i * stride]};
    };
    WheelMotion<Pair> wheel;
    Pair center[3], com[3];
    gather(d->xpos + 3 * a.body, d->xpos + 3 * b.body, 1, center);
    gather(d->xmat + 9 * a.hub + 1, d->xmat + 9 * b.hub + 1, 3, wheel.axle);
    // cvel is (angular, linear) about the tree's center of mass.
    gather(d->subtree_com + 3 * a.root, d->subtree_com + 3 * b.root, 1, com);
    gather(d->cvel + 6 * a.hub, d->cvel + 6 * b.hub, 1, wheel.angular);
    gather(d->cvel + 6 * a.hub + 3, d->cvel + 6 * b.hub + 3, 1, wheel.velocity);
    for (int i = 0; i < 3; ++i) wheel.arm[i] = center[i] - com[i];
    wheel.height = center[2];
    wheel.spin = Pair{d->qvel[a.dof], d->qvel[b.dof]};
    wheel.carry = Pair{a.carry, b.carry};

    const RoadPoint<Pair> road = road_.Evaluate(m->numeric_data + road_address_, center[0],
                                                center[1], Pair{sa->station, sb->station});
    const TireBristles<Pair> bristles = {{sa->bristles.x, sb->bristles.x},
                                         {sa->bristles.y, sb->bristles.y},
                                         {sa->bristles.spin, sb->bristles.spin}};
    const TireForces<Pair> forces =
        law_.Step(wheel, road, bristles, m->opt.timestep, Pair{sa->puncture, sb->puncture});

    State* const states[2] = {sa, sb};
    for (int k = 0; k < 2; ++k) {
      states[k]->next_station = road.station[k];
      states[k]->next_bristles = {forces.next.x[k], forces.next.y[k], forces.next.spin[k]};
      for (int i = 0; i < forces.kSignals; ++i) states[k]->signal[i] = forces.signal[i][k];
      for (int i = 0; i < 3; ++i) {
        wrenches[k].force[i] = forces.force[i][k];
        wrenches[k].moment[i] = forces.moment[i][k];
      }
    }
  }

  Tire<double> law_;
  RoadTable road_;
  int road_address_ = 0;
  std::vector<Wheel> wheels_;
  int common_dof_ = -1;  // last degree of freedom that moves all wheels
  std::vector<Sensor> sensors_;
};

}  // namespace

TirePart TireOf(const mjData* d, int instance) {
  return reinterpret_cast<const TirePlugin*>(d->plugin_data[instance])->Part();
}

void RegisterTire() { RegisterPlugin<TirePlugin>("iits.tire", mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR); }

}  // namespace iits
