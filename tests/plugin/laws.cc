// Calls every law of the plugin with double, float and dual numbers, without MuJoCo, and prints
// `name value` lines. test_laws.py compiles it, runs it and knows what the values must be.
#include <cmath>
#include <cstdio>

#include "laws_truck.h"
#include "plugin/laws/aerodynamics.h"
#include "plugin/laws/air_brake.h"
#include "plugin/laws/fifth_wheel.h"
#include "plugin/laws/powertrain.h"
#include "plugin/laws/steering.h"
#include "plugin/laws/tire.h"

namespace dual {

// A value and its derivative. Knows nothing of the laws, as they know nothing of it.
struct Dual {
  double v = 0, d = 0;
  Dual() = default;
  Dual(double value, double derivative = 0) : v(value), d(derivative) {}
  explicit operator int() const { return static_cast<int>(v); }

  friend Dual operator-(Dual a) { return {-a.v, -a.d}; }
  friend Dual operator+(Dual a, Dual b) { return {a.v + b.v, a.d + b.d}; }
  friend Dual operator-(Dual a, Dual b) { return {a.v - b.v, a.d - b.d}; }
  friend Dual operator*(Dual a, Dual b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
  friend Dual operator/(Dual a, Dual b) { return {a.v / b.v, (a.d - a.v / b.v * b.d) / b.v}; }
  Dual& operator+=(Dual b) { return *this = *this + b; }
  Dual& operator-=(Dual b) { return *this = *this - b; }
  Dual& operator*=(Dual b) { return *this = *this * b; }
  Dual& operator/=(Dual b) { return *this = *this / b; }
  friend bool operator<(Dual a, Dual b) { return a.v < b.v; }
  friend bool operator>(Dual a, Dual b) { return a.v > b.v; }
  friend bool operator<=(Dual a, Dual b) { return a.v <= b.v; }
  friend bool operator>=(Dual a, Dual b) { return a.v >= b.v; }
  friend bool operator==(Dual a, Dual b) { return a.v == b.v; }
  friend bool operator!=(Dual a, Dual b) { return a.v != b.v; }
};

// A constant stays a constant, also where the function has no slope, such as sqrt at 0.
Dual Chain(Dual a, double value, double slope) { return {value, a.d == 0 ? 0 : slope * a.d}; }
Dual abs(Dual a) { return Chain(a, std::abs(a.v), a.v < 0 ? -1 : 1); }
Dual atan(Dual a) { return Chain(a, std::atan(a.v), 1 / (1 + a.v * a.v)); }
Dual cos(Dual a) { return Chain(a, std::cos(a.v), -std::sin(a.v)); }
Dual exp(Dual a) { return Chain(a, std::exp(a.v), std::exp(a.v)); }
Dual floor(Dual a) { return std::floor(a.v); }
Dual log(Dual a) { return Chain(a, std::log(a.v), 1 / a.v); }
Dual pow(Dual a, Dual b) { return Chain(a, std::pow(a.v, b.v), b.v * std::pow(a.v, b.v - 1)); }
Dual sin(Dual a) { return Chain(a, std::sin(a.v), std::cos(a.v)); }
Dual sqrt(Dual a) { return Chain(a, std::sqrt(a.v), 0.5 / std::sqrt(a.v)); }
Dual tan(Dual a) { return Chain(a, std::tan(a.v), 1 + std::tan(a.v) * std::tan(a.v)); }

}  // namespace dual

namespace {

using dual::Dual;
using namespace iits;

double Value(double x) { return x; }
float Value(float x) { return x; }
double Value(Dual x) { return x.v; }
void Print(const char* name, double value) { std::printf("%s %.17g\n", name, value); }
void Print(const char* name, float value) { std::printf("%s.float %.9g\n", name, value); }
void Print(const char* name, Dual x) {
  std::printf("%s.dual %.17g\n%s.slope %.17g\n", name, x.v, name, x.d);
}

// `x` with the derivative 1.
template <class T>
T Seed(double x) {
  return x;
}
template <>
Dual Seed(double x) {
  return {x, 1};
}

template <class T>
void TireLaws() {
  const Tire<T> tire = MakeTire<T>();
  const T load = 60e3, relative = load * tire.inverse_nominal_load, one = 1;
  Print("tire_fy_at_zero_slip", tire.Combine(T(0), Seed<T>(0), load, relative, one).fy);
  Print("tire_fx_at_zero_slip", tire.Combine(Seed<T>(0), T(0), load, relative, one).fx);
  Print("tire_fy_at_slip", tire.Combine(T(0), Seed<T>(0.2), load, relative, one).fy);

  // A wheel at rest on a plane, 20 mm deflected, then rolling; on the road of one grade.
  WheelMotion<T> wheel = {};
  wheel.height = Seed<T>(0.5225);
  wheel.axle[1] = 1;
  wheel.carry = tire.Carry(34);
  const double rows[2][RoadTable::kColumns] = {{0, 0, 0, 1, 0, 0, 0.1, 0, 0.7, 0.3, 0},
                                               {100, 0, 10, 1, 0, 0, 0.1, 0, 0.7, 0.3, 0}};
  const T unknown = RoadTable::kUnknownStation;
  const RoadPoint<T> plane = RoadTable().Evaluate(nullptr, T(0), T(0), unknown);
  Print("tire_fz", tire.Step(wheel, plane, {}, 0.002).signal[2]);
  RoadTable road;
  road.count = 2, road.step = 100, road.inverse_step = 0.01;
  const RoadPoint<T> slope = road.Evaluate(rows[0], Seed<T>(40), T(1), unknown);
  Print("road_height", slope.height);
  Print("road_friction_left", slope.friction);
  Print("road_station", slope.station);
  TireBristles<T> bristles = {};
  TireForces<T> forces = {};
  wheel.velocity[0] = 10, wheel.velocity[1] = 0.3, wheel.spin = 10 / 0.5267;
  for (int i = 0; i < 500; ++i) {
    forces = tire.Step(wheel, plane, bristles, 0.002);
    bristles = forces.next;
  }
  Print("tire_slip_angle", forces.signal[5]);
  Print("tire_fy_rolling", forces.signal[1]);
}

// The pair of wheels that the plugin computes at once gives the bits of one wheel.
void TirePair() {
  const Tire<double> tire = MakeTire<double>();
  const TireSlip<Pair> both = tire.Combine(Pair{0.01, -0.05}, Pair{0.02, 0.04}, Pair{4e4, 6e4},
                                           Pair{0.6, 0.9}, Pair{1, 0.5});
  const TireSlip<double> a = tire.Combine(0.01, 0.02, 4e4, 0.6, 1.);
  const TireSlip<double> b = tire.Combine(-0.05, 0.04, 6e4, 0.9, 0.5);
  Print("tire_pair_differs", std::abs(both.fx[0] - a.fx) + std::abs(both.fy[0] - a.fy) +
                                 std::abs(both.fx[1] - b.fx) + std::abs(both.fy[1] - b.fy));
}

template <class T>
void ChassisLaws() {
  const FifthWheel<T> plate = {2e6, 0, 0.02, 0.9, 150e3, 8e3, 0};
  Print("fifth_wheel_roll_closed", plate.RollMoment(Seed<T>(0.01), T(0)));
  Print("fifth_wheel_roll_open", plate.RollMoment(Seed<T>(0.04), T(0)));
  T wind_up = 0;
  Print("fifth_wheel_yaw", plate.YawMoment(T(1), T(0.01), &wind_up));
  const Steering<T> steering = {20, 0.1, 30, 15, 1e5, 0.1, {3.6}, {2.05}};
  T targets[2];
  steering.Targets(0, T(3), targets);
  Print("steering_left", targets[0]);
  Print("steering_right", targets[1]);
  Print("steering_step", steering.Step(Seed<T>(1), T(0.002), {0, 0}).wheel_angle);
  const Aerodynamics<T> air = {1.2, 6, 40, {}, 0, {}};
  T force[2];
  air.Force(Seed<T>(20), T(20), T(0), force);
  Print("air_drag", force[0]);
}

// A vehicle of one mass that accelerates for 30 s and then brakes without friction for 10 s; the
// derivative is that with respect to the mass.
template <class T>
void Drive(const char* strategy, double mass_now) {
  const Powertrain<T> powertrain = MakePowertrain<T>(strategy[0] == 'a');
  const T mass = Seed<T>(mass_now), h = 0.002;
  PowertrainState<T> state = {};
  T shaft_speed = 0;
  for (int i = 0; i < 20000; ++i) {
    PowertrainControls<T> controls = {{0.8, 0, 0}, GearboxInput<T>::kDrive, {}, mass, 0};
    if (i >= 15000) controls.levers = {0, 1, 0.5};
    powertrain.Step(controls, shaft_speed, h, &state);
    shaft_speed += h * state.next.shaft_torque / powertrain.gearbox.gears.VehicleInertia(mass);
    state.Commit(shaft_speed, h);
    if (i == 14999 || i == 19999) {
      char name[80];
      std::snprintf(name, sizeof(name), "drive_%s_%g_speed_%d", strategy, mass_now, (i + 1) / 500);
      Print(name, T(powertrain.gearbox.gears.Speed(shaft_speed)));
      if (mass_now != 19000) continue;
      std::snprintf(name, sizeof(name), "drive_%s_gear_%d", strategy, (i + 1) / 500);
      Print(name, Value(state.now.gearbox.gear));
      std::snprintf(name, sizeof(name), "drive_%s_energy_%d", strategy, (i + 1) / 500);
      const EnergyAccount<T>& energy = state.now.energy;
      const T speed = powertrain.gearbox.gears.Speed(shaft_speed);
      const T stored = Driveline<T>::Energy(state.now.driveline, state.now.engine.speed) -
                       0.5 * (2.21 + 0.15) * 62.8 * 62.8;
      const T spent = energy.clutch_loss + energy.gear_loss + energy.retarder_work + stored +
                      0.5 * mass * speed * speed;
      Print(name, Value((energy.engine_work - spent) / energy.engine_work));
    }
  }
}

template <class T>
void PowertrainLaws() {
  const Powertrain<T> p = MakePowertrain<T>(false);
  const Engine<T>& e = p.engine;
  Print("engine_full_torque", e.PedalTorque(Seed<T>(136), T(1)));
  Print("engine_overrun", e.PedalTorque(Seed<T>(150), T(0)));
  const EnginePoint<T> at = e.At(T(126));
  EngineState<T> s = {};
  s.torque = 1170 + at.drag;
  Print("engine_fuel", e.FuelRate(at, s));
  Print("engine_brake", e.At(Seed<T>(200)).brake_max);
  Print("retarder_half_speed", p.retarder.Available(Seed<T>(22.5), T(0)));
  Print("retarder_power", p.retarder.Available(Seed<T>(300), T(0.5)));
  T torsion = 0, engine_speed = 150;
  const ElasticClutch<T> clutch = {6e4, 6e2};
  Print("clutch_slip",
        clutch.Step(T(0), T(2), T(100), Seed<T>(800), T(0.002), &torsion, &engine_speed));
}

// A vehicle of two wheels that never lock brakes at 3 m/s2 from 15 m/s; the derivative is that with
// respect to its mass.
template <class T>
void Stop(double mass_now) {
  AirBrake<T> brake = MakeAirBrake<T>();
  const T h = 0.002;
  brake.Prepare(h);

  const T mass = Seed<T>(mass_now), radius = 0.51;
  AirBrakeState<T> state = {};
  T speed = 15;
  auto hub = [&speed](size_t) { return speed; };
  auto wheel = [&speed, &radius](size_t) { return speed / radius; };
  for (int i = 0; i < 4000; ++i) {
    BrakeDemand<T> demand = {};
    demand.xbr = 3, demand.xbr_mode = demand.kMaximum;
    demand.speed = speed, demand.mass = mass, demand.gravity = 9.81;
    brake.Step(demand, {0, 0, 100}, 0, h, hub, wheel, &state);
    T force = 0, power = 0;
    for (size_t k = 0; k < 2; ++k) force += brake.Torque(k, wheel(k), h, &state, &power) / radius;
    state.next_work = 0.5 * h * power;
    state.next_wind_up_is_fresh = 1;
    speed -= h * force / (mass + 2 * 25 / (radius * radius));
    brake.Commit(h, wheel, &state);
    char name[40];
    std::snprintf(name, sizeof(name), "stop_%g_speed_%d", mass_now, (i + 1) / 500);
    if (i == 999 || i == 3999) Print(name, speed);
  }
  if (mass_now == 9000) Print("stop_air_left", state.now.reservoir.pressure[kFront]);
}

template <class T>
void BrakeLaws() {
  const WheelBrake<T> w = MakeWheelBrake<T>();
  const WheelBrakeRates<T> rates = w.Rates(0.002);
  WheelBrakeState<T> chamber = {};
  for (int i = 0; i < 100; ++i) w.Update(rates, Seed<T>(5e5), kInfinity, 1, &chamber);
  Print("chamber_filled", chamber.pressure);
  Print("brake_torque", w.Torque(chamber, 0));
  T wind_up = 0, torque = 0;
  for (int i = 0; i < 100; ++i) torque = w.Grip(rates, Seed<T>(1000), 2, &wind_up);
  Print("brake_slides", torque);
  T slow;
  Print("abs_duty", w.Duty(rates, {3e5, 3e5, 0, 0.15, 0}, Seed<T>(10), 8.5 / 0.51, &slow));
  DeadTimeLine<T> line = {};
  T supply[kCircuits] = {};
  for (int i = 1; i <= 200; ++i) {
    supply[kTrailer] = 1e3 * i;
    line.Push(supply, 0.002, 0.01);
  }
  Print("delayed_ramp", line.Look(kTrailer, 0.1, 0.002, Seed<T>(201e3)));
}

template <class T>
void All() {
  TireLaws<T>();
  ChassisLaws<T>();
  PowertrainLaws<T>();
  BrakeLaws<T>();
  for (const char* strategy : {"tables", "adaptive"}) Drive<T>(strategy, 19000);
  Stop<T>(9000);
}

}  // namespace

int main() {
  All<double>();
  All<float>();
  All<Dual>();
  TirePair();
  for (double mass : {18999., 19001.}) Drive<double>("tables", mass);
  for (double mass : {8999., 9001.}) Stop<double>(mass);
  return 0;
}
