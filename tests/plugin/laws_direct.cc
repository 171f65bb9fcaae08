// The plugin's laws as C functions of numbers, so that a test can call each with its own arguments.
// laws_direct.py compiles and loads it. Structs of the laws are arrays of their numbers, in order.
#include <algorithm>
#include <array>
#include <cstring>

#include "laws_truck.h"
#include "plugin/laws/aerodynamics.h"
#include "plugin/laws/fifth_wheel.h"
#include "plugin/laws/planar.h"
#include "plugin/laws/steering.h"

namespace {

using namespace iits;

template <class Struct>
Struct Read(const double* numbers) {
  Struct out = {};
  std::memcpy(&out, numbers, sizeof(out));
  return out;
}
template <class Struct>
void Write(const Struct& in, double* numbers) {
  std::memcpy(numbers, &in, sizeof(in));
}

// Reads a state, changes it, and writes it back.
template <class Struct, class Function>
auto Change(double* numbers, const Function& f) {
  Struct s = Read<Struct>(numbers);
  struct Keep {
    Struct* s;
    double* numbers;
    ~Keep() { Write(*s, numbers); }
  } keep = {&s, numbers};
  return f(&s);
}

const Tire<double>& TireOf(const double* attributes) {
  static Tire<double> tire = {};
  constexpr size_t kSize = 23 * sizeof(double);
  if (std::memcmp(&tire.count, attributes, kSize) != 0) {
    std::memcpy(&tire.count, attributes, kSize);
    tire.Prepare();
  }
  return tire;
}

// By strategy: tables, adaptive, and tables whose speeds for downshifts are three times as high.
const Powertrain<double>& Truck(int strategy) {
  static const auto kTrucks = [] {
    std::array<Powertrain<double>, 3> trucks = {
        MakePowertrain<double>(false), MakePowertrain<double>(true), MakePowertrain<double>(false)};
    for (double& speed : trucks[2].gearbox.strategy.downshift.values) speed *= 3;
    return trucks;
  }();
  return kTrucks[strategy];
}

BrakeControl<double> Control(const double* attributes) {
  BrakeControl<double> c = MakeAirBrake<double>().control;
  std::memcpy(&c.rise_rate, attributes, 21 * sizeof(double));
  for (int circuit = 0; circuit < kCircuits; ++circuit) {
    for (int side = 0; side < 2; ++side) c.AddWheel(circuit, 0.5, 25, 0.05);
  }
  c.response_time = 0.3;
  BrakeDistribution<double>& d = c.distribution;
  d.demand = {0, 10};
  d.light = {0.5, 0.3, 0.2, 0.6, 0.2, 0.2};
  d.heavy = {0.3, 0.4, 0.3, 0.4, 0.3, 0.3};
  d.mass_light = 10e3, d.mass_heavy = 40e3, d.push_out = 25e3;
  return c;
}

WheelBrake<double> Wheel(int circuit) {
  WheelBrake<double> w = MakeWheelBrake<double>();
  w.circuit = circuit;
  return w;
}

// `input` is a GearboxInput from the pedal on, without clutch_open, which comes last; of the engine
// it has the speed.
GearboxInput<double> InputOf(const double* input) {
  return {GearboxInput<double>::kDrive,
          input[0],
          input[1],
          input[2],
          input[3],
          {input[4], 0, 0, 0, 0, 0},
          input[8] != 0,
          input[5],
          input[6],
          input[7],
          0};
}

// Calls `f` with the situation in `gear`; `state` is a GearboxState.
template <class Function>
auto Situated(int adaptive, int gear, const double* input, const double* state, const Function& f) {
  const Powertrain<double>& p = Truck(adaptive);
  GearboxInput<double> in = InputOf(input);
  const GearboxState<double> s = Read<GearboxState<double>>(state);
  const ShiftSituation<double> now = {p.gearbox.strategy, p.gearbox.gears, p.engine, in, s, gear};
  // The charge of the turbocharger has settled at the torque.
  const double speed = now.InputSpeed();
  in.engine.torque = now.EngineTorque(gear, in.shaft_torque, speed) + p.engine.drag(speed);
  in.engine.boost_demand = in.engine.boost = in.engine.torque;
  return f(now);
}

}  // namespace

extern "C" {

// Tire: `attributes` of the struct, `wheel` a WheelMotion, `road` a RoadPoint, `lost` the share of
// the pressure, `bristles` those before and after all steps, `out` the TireForces of the last one.
void tire_steps(const double* attributes, const double* wheel, const double* road, double lost,
                int steps, double h, double* bristles, double* out) {
  const Tire<double>& tire = TireOf(attributes);
  for (int i = 0; i < steps; ++i) {
    const TireForces<double> forces =
        tire.Step(Read<WheelMotion<double>>(wheel), Read<RoadPoint<double>>(road),
                  Read<TireBristles<double>>(bristles), h, lost);
    Write(forces.next, bristles);
    Write(forces, out);
  }
}
double tire_carry(const double* attributes, double inertia) {
  return TireOf(attributes).Carry(inertia);
}

void road_evaluate(const double* rows, int count, double start, double step, double x, double y,
                   double hint, double* out) {
  RoadTable road;
  road.count = count, road.start = start, road.step = step, road.inverse_step = 1 / step;
  Write(road.Evaluate(rows, x, y, hint), out);
}

FifthWheel<double> FifthWheelOf(const double* a) {
  return {a[0], a[1], a[2], a[3], a[4], a[5], static_cast<int>(a[6])};
}
double fifth_wheel_roll(const double* attributes, double roll, double rate) {
  return FifthWheelOf(attributes).RollMoment(roll, rate);
}
double fifth_wheel_yaw(const double* attributes, double rate, double h, double* wind_up) {
  return FifthWheelOf(attributes).YawMoment(rate, h, wind_up);
}

// `attributes`: six numbers of Steering, then wheelbase and track of each axle.
Steering<double> SteeringOf(const double* attributes, int axles = 1) {
  const double *a = attributes, *wheelbase = a + 6, *track = wheelbase + axles;
  return {a[0], a[1], a[2], a[3], a[4], a[5], {wheelbase, track}, {track, track + axles}};
}
void steering_targets(const double* attributes, int axles, int axle, double angle, double* out) {
  SteeringOf(attributes, axles).Targets(axle, angle, out);
}
void steering_step(const double* attributes, double demand, double h, double* state) {
  Write(SteeringOf(attributes).Step(demand, h, Read<SteeringState<double>>(state)), state);
}

void air_force(const double* attributes, double forward, double side, double up, double* out) {
  const double speed = std::sqrt(forward * forward + side * side + up * up);
  Aerodynamics<double> law = {attributes[0], attributes[1], attributes[2], {}, 0, {}};
  law.Force(speed, forward, side, out);
}
// With an increase of 0, 1 and 3 m2 at the yaw angles 0, 0.1 and 0.3, and a mean wind.
void air_force_in_wind(double mean_wind, double forward, double side, double* out) {
  static Aerodynamics<double> law = {1.2, 6, 40, {{0, 0.1, 0.3}, {0, 1, 3}}, -1, {}};
  if (law.mean_wind != mean_wind) {
    law.mean_wind = mean_wind;
    law.Prepare();
  }
  law.Force(std::hypot(forward, side), forward, side, out);
}

// Slip control of the driven wheels; `slips` of `count` wheels.
DriveSlip<double> SlipsOf(const double* slips, int count) {
  DriveSlip<double> slip;
  for (int i = 0; i < count; ++i) slip.Add(slips[i]);
  return slip;
}
double drag_relief(const double* attributes, double slip, double speed, double h, double* state) {
  double relief;
  Change<DriveSlipState<double>>(state, [&](auto* s) {
    relief = Read<DriveSlipControl<double>>(attributes).Drag(slip, speed, h, s);
  });
  return relief;
}
double traction_cut(const double* attributes, const double* slips, int count, double speed,
                    double h, double* state) {
  double cut;
  Change<DriveSlipState<double>>(state, [&](auto* s) {
    cut = Read<DriveSlipControl<double>>(attributes).Traction(SlipsOf(slips, count), speed, h, s);
  });
  return cut;
}
double traction_pressure(const double* attributes, const double* slips, int count, double slip,
                         double speed) {
  return Read<DriveSlipControl<double>>(attributes).Pressure(SlipsOf(slips, count), slip, speed);
}
double wheel_slip(double hub_speed, double wheel_speed) {
  return MakeWheelBrake<double>().Slip(hub_speed, wheel_speed);
}

// Reservoirs.
void reservoir_pump(const double* attributes, double engine_speed, double h, double* state) {
  Change<ReservoirState<double>>(
      state, [&](auto* s) { Read<Reservoirs<double>>(attributes).Pump(engine_speed, h, s); });
}
void reservoir_draw(const double* attributes, int circuit, double air, double* state) {
  Change<ReservoirState<double>>(
      state, [&](auto* s) { Read<Reservoirs<double>>(attributes).Draw(circuit, air, s); });
}
double reservoir_springs(const double* attributes, int circuit, const double* state) {
  return Read<Reservoirs<double>>(attributes).Springs(circuit, Read<ReservoirState<double>>(state));
}

// Brake lines: a ramp of `slope` per second in one circuit, looked at after `time`; `longest` is
// the greatest delay that the ring holds.
double line_after_ramp(int circuit, double slope, double time, double delay, double longest,
                       double h) {
  DeadTimeLine<double> line = {};
  double supply[kCircuits] = {};
  const int steps = static_cast<int>(time / h + 0.5);
  for (int i = 1; i < steps; ++i) {
    supply[circuit] = slope * i * h;
    line.Push(supply, h, longest / (DeadTimeLine<double>::kSlots - 2));
  }
  return line.Look(circuit, delay, h, slope * steps * h);
}
double line_last_used(int circuit, double pressure, double used, double time, double h) {
  DeadTimeLine<double> line = {};
  double supply[kCircuits] = {};
  for (int i = 1; i * h <= time + 1e-9; ++i) {
    supply[circuit] = i * h <= used + 1e-9 ? pressure : 0;
    line.Push(supply, h, 0.01);
  }
  return line.last_used;
}

// Wheel brake: a state is pressure, effective, abs_active, slip.
double wheel_torque(const double* state, double parking) {
  return Wheel(0).Torque(Read<WheelBrakeState<double>>(state), parking);
}
double wheel_air(const double* state) { return Wheel(0).Air(Read<WheelBrakeState<double>>(state)); }
void wheel_rates(double stiffness, double inertia, double h, double* out) {
  WheelBrake<double> w = Wheel(0);
  w.stiffness = stiffness, w.inertia = inertia;
  Write(w.Rates(h), out);
}
double wheel_grip(double capacity, double speed, double h, double* wind_up) {
  return WheelBrake<double>::Grip(Wheel(0).Rates(h), capacity, speed, wind_up);
}
double wheel_duty(const double* state, double hub_speed, double wheel_speed, double h,
                  double* slow) {
  return Wheel(0).Duty(Wheel(0).Rates(h), Read<WheelBrakeState<double>>(state), hub_speed,
                       wheel_speed, slow);
}
double wheel_rise_max(int circuit, const double* state, const double* other, int active, double h) {
  const auto own = Read<WheelBrakeState<double>>(state);
  return Wheel(circuit).RiseMax(Wheel(0).Rates(h), own, own.abs_active != 0,
                                Read<WheelBrakeState<double>>(other), active != 0);
}
int wheel_active(double supply, double duty, const double* state) {
  return Wheel(0).Active(supply, duty, Read<WheelBrakeState<double>>(state));
}
void wheel_update(double supply, double rise_max, double duty, double h, double* state) {
  Change<WheelBrakeState<double>>(
      state, [&](auto* s) { Wheel(0).Update(Wheel(0).Rates(h), supply, rise_max, duty, s); });
}

// Brake control of three circuits of two wheels each; `attributes` from rise_rate on. `demand`:
// xbr, pedal, XBR mode, EBI mode, speed, mass, gravity, ABS, ABS on a driven wheel, shaft force,
// its greatest value, uphill torque, reservoir pressure. `effort`: shaft force, active.
void brake_update(const double* attributes, const double* demand, double h, double* state,
                  double* effort) {
  using Demand = BrakeDemand<double>;
  Demand d = {};
  const double reservoir[kCircuits] = {demand[12], demand[12], demand[12]};
  d.xbr = demand[0], d.pedal = demand[1];
  d.xbr_mode = static_cast<Demand::XbrMode>(demand[2]);
  d.ebi_mode = static_cast<Demand::EbiMode>(demand[3]);
  d.speed = demand[4], d.mass = demand[5], d.gravity = demand[6];
  d.abs_active = demand[7] != 0, d.abs_on_drive = demand[8] != 0;
  d.shaft_force = demand[9], d.shaft_force_max = demand[10], d.uphill_torque = demand[11];
  d.reservoir = reservoir;
  Change<BrakeControlState<double>>(state, [&](auto* s) {
    const BrakeEffort<double> out = Control(attributes).Update(d, h, s);
    effort[0] = out.shaft_force, effort[1] = out.active;
  });
}
void brake_pressures(const double* attributes, double friction, double shaft_force,
                     double deceleration, double mass, double* out) {
  Control(attributes).distribution.Pressures(friction, shaft_force, deceleration, mass, out);
}

// Engine: a state is speed, torque, boost demand, boost, idle integral, brake torque. `request`:
// mode, pedal, engine brake, time left, target speed, inertia, limited, torque.
void engine_at(double speed, double* out) { Write(Truck(0).engine.At(speed), out); }
void engine_with_auxiliaries_at(double power, double speed, double* out) {
  Engine<double> engine = Truck(0).engine;
  engine.auxiliary_power = power;
  Write(engine.At(speed), out);
}
// With a map of the rate from -50 N m on: 5 g/s there, 10 g/s at 350 N m.
double engine_fuel_by_rate(double indicated, double drag) {
  Engine<double> engine = Truck(0).engine;
  engine.fuel_map = {};
  engine.fuel_rate = {{-50, 350}, {50, 250}, {5e-3, 5e-3, 1e-2, 1e-2}};
  EngineState<double> state = {};
  state.torque = indicated;
  return engine.FuelRate({100, drag, 2000, 0, 0}, state);
}
double engine_pedal_torque(double speed, double pedal) {
  return Truck(0).engine.PedalTorque(speed, pedal);
}
double engine_fuel_rate(const double* state) {
  const Engine<double>& e = Truck(0).engine;
  return e.FuelRate(e.At(state[0]), Read<EngineState<double>>(state));
}
void engine_update(const double* request, double h, double* state) {
  EngineRequest<double> r;
  r.mode = static_cast<EngineRequest<double>::Mode>(request[0]);
  r.pedal = request[1], r.engine_brake = request[2], r.time_left = request[3];
  r.target_speed = request[4], r.inertia = request[5];
  r.limited = request[6] != 0, r.torque = request[7];
  const Engine<double>& e = Truck(0).engine;
  Change<EngineState<double>>(state, [&](auto* s) { e.Update(r, e.At(s->speed), h, s); });
}
void engine_recovery(const double* state, double pause, double demand, double level, double drag,
                     double* out) {
  const auto now = Read<EngineState<double>>(state);
  Write(Truck(0).engine.Recovery(now, pause, demand, level, drag), out);
}

// Driveline.
double clutch_step(double stiffness, double damping, double engine_torque, double inertia,
                   double input_speed, double capacity, double h, double* state) {
  const ElasticClutch<double> clutch = {stiffness, damping};
  return clutch.Step(engine_torque, inertia, input_speed, capacity, h, &state[0], &state[1]);
}
double clutch_control(double engagement, double engine_speed, double input_speed, double pedal,
                      double h) {
  return Truck(0).driveline.control.Update(engagement, engine_speed, input_speed, pedal, h);
}
double clutch_stall_guard(double engine_speed) {
  return Truck(0).driveline.control.StallGuard(engine_speed);
}
// `gear`: ratio, inertia, efficiency of a gear without a map, and of the axle; `torques` a
// DrivelineTorques; `state`: torsion, engagement, inertia, stiffness; `work`: a
// StepWork. Returns the engine's speed.
double driveline_step(const double* gear, const double* torques, double shaft_speed, double h,
                      double engine_speed, double* state, double* work) {
  return Change<DrivelineState<double>>(state, [&](auto* s) {
    StepWork<double> w;
    Truck(0).driveline.Step({gear[0], gear[1], {gear[2], nullptr}}, {gear[3], nullptr},
                            Read<DrivelineTorques<double>>(torques), shaft_speed, h, s,
                            &engine_speed, &w);
    Write(w, work);
    return engine_speed;
  });
}
// Torque at the shaft and its inverse, with efficiencies or with maps of losses.
const Gears<double>& GearsOf(int maps) {
  static const auto kGears = [] {
    std::array<Gears<double>, 2> gears = {Truck(0).gearbox.gears, Truck(0).gearbox.gears};
    gears[1].loss_maps = {{{0, 200}, {-500, 0, 2000}, {12, 4, 44, 16, 8, 60}}};
    gears[1].map_of_gear = {1, 1, 1, 1, 0};
    gears[1].axle_loss = {{0, 300}, {-3000, 0, 8000}, {100, 15, 250, 140, 40, 300}};
    gears[1].retarder_drag = {{0, 300}, {10, 90}};
    return gears;
  }();
  return kGears[maps];
}
double gears_shaft_torque(int maps, int gear, double torque, double speed) {
  return GearsOf(maps).ShaftTorque(gear, torque, speed);
}
double gears_input_torque(int maps, int gear, double torque, double speed) {
  return GearsOf(maps).InputTorque(gear, torque, speed);
}
double driveline_energy(const double* state, double engine_speed) {
  return Driveline<double>::Energy(Read<DrivelineState<double>>(state), engine_speed);
}
void book_work(const double* work, double end_speed, double h, double* account) {
  Change<EnergyAccount<double>>(
      account, [&](auto* a) { Read<StepWork<double>>(work).Book(end_speed, h, a); });
}

double retarder_available(const double* attributes, double shaft_speed, double heat) {
  return Read<Retarder<double>>(attributes).Available(shaft_speed, heat);
}
double retarder_update(const double* attributes, double wanted, double available,
                       double shaft_speed, double h, double* state) {
  return Change<RetarderState<double>>(state, [&](auto* s) {
    return Read<Retarder<double>>(attributes).Update(wanted, available, shaft_speed, h, s);
  });
}
// `levers`: pedal, engine brake, retarder; `demand`: shaft torque, cut; `gearing`: an
// EnduranceGearing; `out`: pedal, engine brake, retarder torque.
void endurance_update(const double* attributes, const double* levers, const double* demand,
                      const double* gearing, double drag, double brake_max, double retarder_max,
                      double h, double* held_back, double* out) {
  Write(Read<EnduranceControl<double>>(attributes)
            .Update(Read<EnduranceLevers<double>>(levers), Read<EnduranceDemand<double>>(demand),
                    Read<EnduranceGearing<double>>(gearing), drag, brake_max, retarder_max, h,
                    held_back),
        out);
}

double pull_torque(const double* demand, double drag) {
  return EnduranceControl<double>::PullTorque(Read<EnduranceDemand<double>>(demand), drag);
}

// Tables.
double curve(const double* x, const double* y, int count, double at) {
  return Curve<double>{{x, x + count}, {y, y + count}}(at);
}
double map(const double* rows, int m, const double* columns, int n, const double* values,
           double row, double column) {
  return Map<double>{{rows, rows + m}, {columns, columns + n}, {values, values + m * n}}(row,
                                                                                         column);
}
double uniform_curve_of_squares(double low, double high, int intervals, double at) {
  UniformCurve<double> c;
  c.Sample([](double x) { return x * x; }, low, high, intervals);
  return c(at);
}
double sampled_sine(double low, double high, int intervals, double at) {
  Sampled<double> c;
  c.Sample([](double x) { return std::sin(x); }, low, high, intervals);
  return c(at, [](double) { return 10.; });
}
double clamp(double x, double low, double high) { return Clamp(x, low, high); }
double lag_share(double h, double tau) { return LagShare(h, tau); }
void cross(const double* a, const double* b, double* out) { Cross(a, b, out); }
double dot(const double* a, const double* b) { return Dot(a, b); }

// A drive of `seconds` at constant controls: pedal, engine brake, retarder, mode, shaft torque
// demand, cut, mass, grade force. `state` has room for a PowertrainState, all zero at the start;
// `signals`, an array of `columns` numbers per 0.1 s, gets core, message to the brakes, and output.
// Returns the shaft's speed.
double drive(int adaptive, const double* controls, double seconds, double shaft_speed, double h,
             double* state, double* signals) {
  const Powertrain<double>& p = Truck(adaptive);
  const PowertrainControls<double> c = {{controls[0], controls[1], controls[2]},
                                        static_cast<GearboxInput<double>::Mode>(controls[3]),
                                        {controls[4], controls[5], 0, 0},
                                        controls[6],
                                        0};
  const double radius = p.gearbox.gears.meters_per_radian;
  PowertrainState<double> s = Read<PowertrainState<double>>(state);
  const int steps = static_cast<int>(seconds / h + 0.5), every = static_cast<int>(0.1 / h + 0.5);
  for (int i = 1; i <= steps; ++i) {
    p.Step(c, shaft_speed, h, &s);
    const double net = s.next.shaft_torque - controls[7] * radius;
    shaft_speed += h * net / p.gearbox.gears.VehicleInertia(controls[6]);
    s.Commit(shaft_speed, h);
    if (i % every == 0) {
      Write(s.now, signals);
      signals += sizeof(s.now) / sizeof(double);
      Write(s.endurance, signals);
      signals += sizeof(s.endurance) / sizeof(double);
      Write(s.output, signals);
      signals += sizeof(s.output) / sizeof(double);
    }
  }
  Write(s, state);
  return shaft_speed;
}
// A vehicle of three axles, one per circuit, with `mass` stops from `speed` on a road of
// `friction`; `demand` as in brake_update, where speed, mass, ABS and reservoir are the vehicle's,
// and `parking`. `signals` gets speed, trim, hold, work, and per wheel speed, pressure and torque
// every 0.05 s.
double stop(const double* demand, double parking, double friction_left, double friction_right,
            double grade_force, double seconds, double speed, double mass, double prepared,
            int repeat, double h, double* signals) {
  AirBrake<double> brake = MakeAirBrake<double>();
  brake.wheels.assign(6, MakeWheelBrake<double>());
  for (int i = 0; i < 6; ++i) {
    brake.wheels[i].circuit = i / 2;
    brake.wheels[i].dead_time = 0.02 + 0.02 * (i / 2);
    brake.wheels[i].parking_torque = i / 2 == kFront ? 0 : 9000;
  }
  BrakeDistribution<double>& d = brake.control.distribution;
  d.light = d.heavy = {0.4, 0.3, 0.3, 0.4, 0.3, 0.3};
  brake.shaft_ratio = 5;
  brake.Prepare(prepared);
  AirBrakeState<double> state = {};
  const double radius = 0.51, inertia = 25, load = mass * 9.81 / 6;
  double spin[6];
  for (double& w : spin) w = speed / radius;
  auto hub = [&](size_t) { return speed; };
  auto wheel = [&](size_t i) { return spin[i]; };
  const int steps = static_cast<int>(seconds / h + 0.5), every = static_cast<int>(0.05 / h + 0.5);
  for (int n = 1; n <= steps; ++n) {
    BrakeDemand<double> x = {};
    x.xbr = demand[0], x.pedal = demand[1];
    x.xbr_mode = static_cast<BrakeDemand<double>::XbrMode>(demand[2]);
    x.ebi_mode = static_cast<BrakeDemand<double>::EbiMode>(demand[3]);
    x.speed = speed, x.mass = mass, x.gravity = 9.81;
    for (int k = 0; k < repeat; ++k)
      brake.Step(x, {demand[9] / 5, demand[10] / 5, 100}, n * h < seconds - 1 ? parking : 0, h, hub,
                 wheel, &state);
    double power = 0, force = 0;
    for (size_t i = 0; i < 6; ++i) {
      const double torque = brake.Torque(i, spin[i], h, &state, &power);
      const double grip = (i % 2 ? friction_right : friction_left) * load;
      const double slip = (speed - spin[i] * radius) / std::max(speed, 0.5);
      const double drag = std::clamp(8 * slip * load, -grip, grip);
      force += drag;
      // Semi-implicit in the slip.
      const double gain = h * 8 * load * radius * radius / (inertia * std::max(speed, 0.5));
      spin[i] += h * (drag * radius - torque) / inertia / (1 + gain);
    }
    state.next_work = 0.5 * h * power;
    state.next_wind_up_is_fresh = 1;
    speed -= h * (force + grade_force) / mass;
    brake.Commit(h, wheel, &state);
    if (n % every) continue;
    *signals++ = speed;
    *signals++ = state.now.control.trim;
    *signals++ = state.now.control.holding;
    *signals++ = state.work;
    *signals++ = state.abs_active;
    *signals++ = state.endurance.shaft_torque;
    for (size_t i = 0; i < kCircuits; ++i) *signals++ = state.now.reservoir.pressure[i];
    for (size_t i = 0; i < kCircuits; ++i) *signals++ = state.now.parking[i];
    for (size_t i = 0; i < 6; ++i) {
      *signals++ = spin[i];
      *signals++ = state.now.wheel[i].pressure;
      *signals++ = state.wind_up.torque[i];
    }
  }
  return speed;
}

// Accelerations (count x 4) and hitch forces (count x 2) of a chain of units.
void planar(int count, int rolls, const double* units, const double* motion, const double* forces,
            double* accelerations, double* hitches) {
  const auto* unit = reinterpret_cast<const PlanarInertia<double>*>(units);
  const auto* at = reinterpret_cast<const PlanarMotion<double>*>(motion);
  const auto* force = reinterpret_cast<const PlanarVector<double>*>(forces);
  auto* out = reinterpret_cast<PlanarVector<double>*>(accelerations);
  auto* hitch = reinterpret_cast<double (*)[2]>(hitches);
  rolls ? Accelerate<true>(unit, at, force, count, out, hitch)
        : Accelerate<false>(unit, at, force, count, out, hitch);
}

// Choice of a gear. Gear to engage, and whether the present one failed.
int shift_choice(int adaptive, int gear, const double* input, const double* state, double h,
                 double* failed) {
  return Situated(adaptive, gear, input, state, [&](const auto& now) {
    const auto choice = ShiftStrategy<double>::Choose(now, h);
    *failed = choice.failed;
    return choice.gear;
  });
}
double shift_low_time(int adaptive, int gear, const double* input, const double* state, double h) {
  return Situated(adaptive, gear, input, state,
                  [h](const auto& now) { return ShiftStrategy<double>::LowTime(now, h); });
}
double work_ahead(int gear, const double* input, const double* state, int next) {
  return Situated(1, gear, input, state,
                  [next](const auto& now) { return LookAhead(now, next).work; });
}
double held_speed(int gear, const double* input, const double* state, int next) {
  return Situated(1, gear, input, state, [&](const auto& now) {
    const auto outcome = now.After(next, now.in.shaft_speed);
    return outcome.uptake == now.kTurns ? outcome.speed : 0.0;
  });
}

int drive_columns() {
  return (sizeof(PowertrainCore<double>) + sizeof(EnduranceState<double>) +
          sizeof(PowertrainOutput<double>)) /
         sizeof(double);
}
int drive_state() { return sizeof(PowertrainState<double>) / sizeof(double); }

}  // extern "C"
