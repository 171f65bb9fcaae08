// The truck of the fast world, a point mass, and the functions that advance many worlds. The NumPy
// form in tests/controllers/decision/numpy_world.py drives the same trips.
#include <cstring>
#include <vector>

#include "kernels/fast_traffic.h"
#include "kernels/kernels.h"

using namespace iits;

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kGravity = 9.81;
// Share of a change during which the truck also occupies the lane that it leaves.
constexpr double kLeaves = 0.7;
constexpr double kShortestChange = 6.0;  // [s]; up to 3 s more
// `IMPOSED`, `IMPOSED_TIME` and `SLOWEST` of controllers/decision/quality.py.
constexpr double kImposed = 2.0, kImposedTime = 8.0, kSlowest = 1.0;
// The observation: ranges and step of the road left [m].
constexpr double kRangeAhead = 250.0, kRangeBehind = 50.0, kProbe = 25.0;
constexpr int kBehind = 2, kAhead = 6;
// A body is in a lane when it reaches at least this far into it, within a distance [m].
constexpr double kIntrusion = 0.3, kLaneReach = 250.0;
constexpr double kPeriods[] = {1900.0, 730.0};  // of the hills [m]

// A vehicle in the truck's sight.
struct Seen {
  double station, offset, lateral_speed;
  const Vehicle* vehicle;
};

// The truck in its world.
class Trip {
 public:
  Trip(World* world, const Laws* laws) : w(*world), laws_(*laws), traffic_(world, laws) {}

  // Starts in the right lane, at the front and speed that are set.
  void Start() {
    w.time = w.acceleration = w.change_left = 0.0;
    w.change_lasts = 1.0;
    w.changed_at = -kInfinity;
    w.speed_max = kInfinity;
    w.lane = w.source = 0;
    w.distance = w.driven_time = w.loss_integral = w.right_time = w.seconds = 0.0;
    w.beside_time = w.watched_until = w.watched_braking = w.imposed_deceleration = 0.0;
    w.time_gap_min = w.collision_time_front = w.collision_time_rear = kInfinity;
    w.change_time_gap_front = w.change_time_gap_rear = kInfinity;
    w.imposed_brakings = w.watched = 0;
    w.decisions = w.changes = w.refused = w.dangerous = w.collisions = 0;
    w.total = w.reward = {};
    w.terminated = w.truncated = 0;
    traffic_.Start();
    traffic_.Fill(Occupied(w.lane));
    Observe();
    for (int k = 1; k < kFrames; ++k) std::memcpy(w.frames[k], w.frames[0], sizeof w.frames[0]);
  }

  // A refusal is 1 without a cause in the traffic, 2 because of a vehicle.
  int Refusal(int decision) const {
    const std::int64_t target = w.lane - decision;
    if (target < 0 || target >= w.lanes || w.time - w.changed_at < laws_.pause - 1e-6) return 1;
    if (decision < 0 && !MayPass()) return 1;
    const Safety& safety = laws_.rules.safety;
    const Vehicle *lead = traffic_.Ahead(w.front, target),
                  *follow = traffic_.Behind(w.front, target);
    if (lead && lead->front - lead->length - w.front < safety.FrontGap(w.speed, lead->speed)) {
      return 2;
    }
    const double rear = w.front - w.truck_length;
    return follow && rear - follow->front < safety.RearGap(w.speed, follow->speed) ? 2 : 0;
  }

  void Step(int decision) {
    const int refusal = decision == 0 ? 0 : Refusal(decision);
    const int side = decision == 0 && Returns() ? 1 : decision;
    const bool changes = side != 0 && refusal == 0;
    double lasts = 1.0;
    if (changes) {
      w.source = w.lane;
      w.lane -= side;
      Watch();
      lasts = kShortestChange + w.random.Quarter();
      w.change_left = w.change_lasts = lasts;
    }
    w.reward = {};
    w.seconds = 0.0;
    bool collided = false;
    while (w.seconds < lasts - 1e-9 && !collided && !Over()) {
      collided = Second();
      const double charge = -w.charge_speed * std::abs(w.speed - w.reference_speed);
      w.reward.speed += charge * std::pow(w.discount, w.seconds);
      w.seconds += 1.0;
    }
    if (w.source != w.lane) {
      w.source = w.lane;
      w.changed_at = w.time;
    }
    w.change_left = 0.0;
    if (decision != 0) {
      w.reward.change = -w.charge_change;
      if (refusal == 2) w.reward.danger = -w.charge_danger;
    }
    if (collided) {
      w.reward.collision = -w.charge_collision * std::pow(w.discount, w.seconds - 1.0);
    }
    ++w.decisions;
    w.changes += changes;
    w.refused += refusal > 0;
    w.dangerous += refusal == 2;
    w.collisions += collided;
    w.total.change += w.reward.change;
    w.total.speed += w.reward.speed;
    w.total.danger += w.reward.danger;
    w.total.collision += w.reward.collision;
    w.terminated = collided;
    w.truncated = Over() && !collided;
  }

  int Decide(const Rule& rule) const {
    if (rule.kind == Rule::kKeep) return 0;
    return rule.Decide(Sees(), laws_.rules);
  }

  // Writes the braking that each decision asks of the new follower; infinite where it is refused.
  void ImposedBraking(double* braking) const {
    const Situation at = Sees();
    braking[0] = Refusal(-1) ? kInfinity : laws_.rules.ImposedBraking(at.speed, at.left);
    braking[1] = 0.0;
    braking[2] = Refusal(1) ? kInfinity : laws_.rules.ImposedBraking(at.speed, at.right);
  }

 private:
  Obstacle Occupied(std::int64_t lane) const { return {w.front, w.truck_length, w.speed, lane}; }

  double Station() const { return w.front - w.front_overhang; }

  bool Over() const { return Station() >= w.end || w.time >= w.duration; }

  // Advances one second and observes; returns whether there was a collision.
  bool Second() {
    const double dt = w.timestep;
    bool collided = false;
    for (long step = std::lrint(1.0 / dt); step > 0; --step) {
      Obstacle lanes[2];
      Drive(dt, lanes, Occupy(lanes));
      traffic_.Step(lanes, Occupy(lanes));
      w.time += dt;
      w.change_left = std::max(0.0, w.change_left - dt);
      w.driven_time += dt;
      w.loss_integral += (w.reference_speed - w.speed) / w.reference_speed * dt;
      w.distance += w.speed * dt;
      if (w.lane == 0) w.right_time += dt;
      if (Beside()) w.beside_time += dt;
      NoteBraking();
      collided = collided || Collided();
    }
    std::memmove(w.frames[1], w.frames[0], (kFrames - 1) * sizeof w.frames[0]);
    Observe();
    return collided;
  }

  double Phase() const { return w.source == w.lane ? 1.0 : 1.0 - w.change_left / w.change_lasts; }

  // Writes the lanes that the truck occupies: its own, and for a part of a change the other one.
  std::ptrdiff_t Occupy(Obstacle* lanes) const {
    lanes[0] = Occupied(w.lane);
    if (w.source == w.lane || !(Phase() < kLeaves)) return 1;
    lanes[1] = Occupied(w.source);
    return 2;
  }

  double Grade(double station) const {
    double grade = 0.0;
    for (int k = 0; k < 2; ++k) {
      grade +=
          w.grade_amplitude[k] * std::sin(2.0 * kPi * station / kPeriods[k] + w.grade_phase[k]);
    }
    return grade;
  }

  // The truck follows its leaders as the planner does, within the engine's power.
  void Drive(double dt, const Obstacle* lanes, std::ptrdiff_t count) {
    const double slope = kGravity * (std::sin(std::atan(Grade(Station()))) + w.rolling);
    const double force = w.power / std::max(w.speed, 4.0) - w.drag * Square(w.speed);
    double wanted = force / w.mass - slope;
    const Following& following = laws_.truck;
    const double aim = std::min(w.reference_speed, w.speed_max);
    for (std::ptrdiff_t i = 0; i < count; ++i) {
      const Vehicle* lead = traffic_.Ahead(w.front, lanes[i].lane);
      if (!lead) continue;
      const double gap = lead->front - lead->length - w.front;
      if (lanes[i].lane == w.lane && w.speed > 1.0 && gap >= 0.0) {
        w.time_gap_min = std::min(w.time_gap_min, gap / w.speed);
      }
      wanted =
          std::min(wanted, following.Follow(w.speed, aim, gap, lead->speed, lead->acceleration));
    }
    wanted = std::min(wanted, following.Idm(w.speed, aim, kInfinity, 0.0));
    wanted = std::max(wanted, -laws_.rules.hardest_braking);
    const double speed = std::max(0.0, w.speed + wanted * dt);
    w.front += 0.5 * (w.speed + speed) * dt;
    w.acceleration = (speed - w.speed) / dt;
    w.speed = speed;
  }

  // Notes the vehicles ahead and behind in the new lane, at the start of a change.
  void Watch() {
    std::vector<Seen> seen;
    See(&seen);
    const Vehicle* behind = nullptr;
    const LaneAround lane = Around(seen, w.lane, &behind);
    const auto note = [](double gap, double speed, double ahead, double* time, double* time_gap) {
      if (speed > ahead) *time = std::min(*time, gap / (speed - ahead));
      if (speed > kSlowest) *time_gap = std::min(*time_gap, gap / speed);
    };
    if (lane.leader.exists()) {
      note(lane.leader.gap, w.speed, lane.leader.speed, &w.collision_time_front,
           &w.change_time_gap_front);
    }
    if (lane.follower.exists()) {
      note(lane.follower.gap, lane.follower.speed, w.speed, &w.collision_time_rear,
           &w.change_time_gap_rear);
    }
    w.watched = behind ? behind->serial : 0;
    w.watched_until = w.time + kImposedTime;
    w.watched_braking = 0.0;
  }

  void NoteBraking() {
    if (w.watched == 0) return;
    for (const Vehicle& v : traffic_) {
      if (v.serial != w.watched || !(v.acceleration < -w.watched_braking)) continue;
      const double braking = -v.acceleration;
      w.imposed_brakings += w.watched_braking <= kImposed && braking > kImposed;
      w.imposed_deceleration += braking - w.watched_braking;
      w.watched_braking = braking;
    }
    if (w.time >= w.watched_until) w.watched = 0;
  }

  // Whether a vehicle in a lane beside the truck's overlaps with its length.
  bool Beside() const {
    for (const Vehicle& v : traffic_) {
      if (!(v.front > w.front - w.truck_length)) continue;
      if (!(v.front - v.length < w.front)) continue;
      double offset, lateral_speed;
      traffic_.Place(v, &offset, &lateral_speed);
      const double lane = std::floor(offset / kLaneWidth + 0.5);
      if (lane >= 0.0 && std::abs(lane - static_cast<double>(w.lane)) == 1.0) return true;
    }
    return false;
  }

  bool Collided() const {
    const double rear = w.front - w.truck_length;
    Obstacle lanes[2];
    const std::ptrdiff_t count = Occupy(lanes);
    for (const Vehicle& v : traffic_) {
      if (!(v.front > rear)) continue;
      if (!(v.front - v.length < w.front)) continue;
      for (std::ptrdiff_t i = 0; i < count; ++i) {
        if (v.lane == lanes[i].lane) return true;
      }
    }
    return false;
  }

  // Writes the vehicles in sight on the highway, from the rear to the front.
  void See(std::vector<Seen>* seen) const {
    for (const Vehicle& v : traffic_) {
      const double distance = v.front - w.front;
      if (!(distance > -w.sight_behind)) continue;
      if (!(distance < w.sight_ahead)) break;
      double offset, lateral_speed;
      traffic_.Place(v, &offset, &lateral_speed);
      if (std::floor(offset / kLaneWidth + 0.5) < 0.0) continue;
      seen->push_back({v.front - 0.5 * v.length, offset, lateral_speed, &v});
    }
  }

  Situation Sees() const {
    std::vector<Seen> seen;
    See(&seen);
    Situation at{w.speed,
                 w.reference_speed,
                 w.truck_length,
                 Around(seen, w.lane),
                 Around(seen, w.lane + 1),
                 Around(seen, w.lane - 1)};
    if (w.truck_keeps_right != 0 && StaysFree(at.here)) at.left.usable = 0.0;
    return at;
  }

  // The laws of a truck that keeps right; see controllers/planning/keep_right.py.
  bool StaysFree(const LaneAround& lane) const {
    const double speed = std::max(w.speed, w.reference_speed);
    return laws_.truck.StaysFree(speed, lane.leader.gap, lane.leader.speed, laws_.keep_right_time);
  }

  bool MayPass() const {
    if (w.truck_keeps_right == 0) return true;
    std::vector<Seen> seen;
    See(&seen);
    return !StaysFree(Around(seen, w.lane));
  }

  bool Returns() const {
    if (w.truck_keeps_right == 0 || Refusal(1) != 0) return false;
    std::vector<Seen> seen;
    See(&seen);
    return StaysFree(Around(seen, w.lane - 1));
  }

  // Writes the follower, too, if asked for.
  LaneAround Around(const std::vector<Seen>& seen, std::int64_t lane,
                    const Vehicle** behind = nullptr) const {
    const double usable = lane >= 0 && lane < w.lanes ? 1.0 : 0.0;
    LaneAround found{usable, {kInfinity, 0.0}, {kInfinity, 0.0}, kInfinity};
    // Stations as the scene has them.
    const double front = Station() + w.front_overhang, rear = front - w.truck_length;
    const double middle = static_cast<double>(lane) * kLaneWidth;
    for (const Seen& s : seen) {
      const double reach = 0.5 * kLaneWidth + 0.5 * laws_.kinds[s.vehicle->kind].width - kIntrusion;
      if (!(std::abs(s.offset - middle) < reach)) continue;
      if (!(std::abs(s.station - front) <= kLaneReach)) continue;
      const double half = 0.5 * s.vehicle->length;
      const double gap = std::max(s.station - half - front, rear - s.station - half);
      Neighbor* end = s.station > front ? &found.leader : &found.follower;
      if (gap < end->gap) {
        *end = {gap, s.vehicle->speed};
        if (behind && end == &found.follower) *behind = s.vehicle;
      }
      found.least_gap = std::min(found.least_gap, gap);
    }
    return found;
  }

  // Distance to the road's end, in steps.
  double RoadLeft() const {
    double distance = 0.0;
    while (distance < kRangeAhead && !(Station() + distance + kProbe > w.end)) distance += kProbe;
    return std::min(distance, kRangeAhead);
  }

  // Writes the newest frame; see controllers/decision/observation.py.
  void Observe() {
    const double from = static_cast<double>(w.source) * kLaneWidth;
    const double step = static_cast<double>(w.lane - w.source) * kLaneWidth;
    Place(from, step, Phase(), w.change_lasts, &w.offset, &w.lateral_speed);
    const double front = Station() + w.front_overhang;
    std::vector<Seen> seen;
    See(&seen);
    std::memset(w.frames[0], 0, sizeof w.frames[0]);
    Write(0, {1.0, RoadLeft(), w.offset, w.speed, w.lateral_speed, w.reference_speed});
    const auto write = [&](int row, const Seen& s, double distance) {
      const double speed = s.vehicle->speed;
      Write(row, {1.0, distance, s.offset - w.offset, speed - w.speed, s.lateral_speed,
                  w.reference_speed - speed});
    };
    int behind = 0, ahead = 0;
    const auto distance = [&](const Seen& s) {
      return s.station + 0.5 * s.vehicle->length - front;
    };
    for (std::size_t i = seen.size(); i-- > 0 && behind < kBehind;) {
      const double d = distance(seen[i]);
      if (d <= 0.0 && d >= -kRangeBehind - w.truck_length) write(1 + behind++, seen[i], d);
    }
    for (std::size_t i = 0; i < seen.size() && ahead < kAhead; ++i) {
      const double d = distance(seen[i]);
      if (d > 0.0 && d <= kRangeAhead) write(1 + kBehind + ahead++, seen[i], d);
    }
  }

  void Write(int row, const double (&values)[kFeatures]) {
    for (int k = 0; k < kFeatures; ++k) {
      const double value = std::min(std::max(values[k] / laws_.scale[k], -1.0), 1.0);
      w.frames[0][row][k] = static_cast<float>(value);
    }
  }

  World& w;
  const Laws& laws_;
  Traffic traffic_;
};

World* At(char* rows, std::ptrdiff_t stride, std::ptrdiff_t i) {
  return reinterpret_cast<World*>(rows + i * stride);
}

bool Ended(const World& world) { return world.terminated != 0 || world.truncated != 0; }

}  // namespace

// The functions take n worlds, `stride` bytes apart.

IITS_KERNEL std::ptrdiff_t iits_world_size() { return sizeof(World); }

// Starts the traffic alone, around a truck.
IITS_KERNEL void iits_traffic_start(World* world, const Laws* laws, const Obstacle* truck) {
  Traffic traffic(world, laws);
  traffic.Start();
  traffic.Fill(*truck);
}

IITS_KERNEL void iits_traffic_spawn(World* world, const Laws* laws, std::ptrdiff_t lane,
                                    double front) {
  Traffic(world, laws).Spawn(static_cast<int>(lane), front);
}

// Advances the traffic by a time step; the truck's own lane is the first obstacle.
IITS_KERNEL void iits_traffic_step(World* world, const Laws* laws, const Obstacle* obstacles,
                                   std::ptrdiff_t count) {
  Traffic(world, laws).Step(obstacles, count);
}

// Writes offsets and lateral speeds of the vehicles, shape (2, n).
IITS_KERNEL void iits_traffic_places(World* world, const Laws* laws, double* places) {
  const Traffic traffic(world, laws);
  for (const Vehicle& v : traffic) {
    traffic.Place(v, places, places + world->count);
    ++places;
  }
}

// Fills the road and makes the first observation.
IITS_KERNEL void iits_worlds_start(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                   const Laws* laws) {
  for (std::ptrdiff_t i = 0; i < n; ++i) Trip(At(rows, stride, i), laws).Start();
}

// Carries out a decision in every world that has not ended.
IITS_KERNEL void iits_worlds_step(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                  const Laws* laws, const std::int64_t* decisions) {
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    World* world = At(rows, stride, i);
    if (!Ended(*world)) Trip(world, laws).Step(static_cast<int>(decisions[i]));
  }
}

// Writes a rule's decisions.
IITS_KERNEL void iits_worlds_decide(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                    const Laws* laws, const Rule* rule, std::int64_t* decisions) {
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    decisions[i] = Trip(At(rows, stride, i), laws).Decide(*rule);
  }
}

// Drives by a rule until the trips end, or for some seconds each.
IITS_KERNEL void iits_worlds_drive(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                   const Laws* laws, const Rule* rule, const double* seconds) {
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    World* world = At(rows, stride, i);
    Trip trip(world, laws);
    world->speed_max = kInfinity;
    const double until = world->time + seconds[i] - 1e-6;
    while (!Ended(*world) && world->time < until) trip.Step(trip.Decide(*rule));
  }
}

// Writes for each world whether it would carry out the decisions left, keep and right.
IITS_KERNEL void iits_worlds_allowed(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                     const Laws* laws, bool* allowed) {
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    const Trip trip(At(rows, stride, i), laws);
    for (int side = -1; side <= 1; ++side) {
      *allowed++ = side == 0 || trip.Refusal(side) == 0;
    }
  }
}

// Writes for each world the braking that left, keep and right ask of the new follower [m/s2].
IITS_KERNEL void iits_worlds_braking(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                     const Laws* laws, double* braking) {
  for (std::ptrdiff_t i = 0; i < n; ++i)
    Trip(At(rows, stride, i), laws).ImposedBraking(braking + 3 * i);
}

// Copies `from[indices[i]]` to row i of `to`, which has `capacity` places for vehicles.
IITS_KERNEL void iits_worlds_copy(char* from, std::ptrdiff_t stride, const std::int64_t* indices,
                                  std::ptrdiff_t n, char* to, std::ptrdiff_t capacity) {
  const std::ptrdiff_t to_stride = sizeof(World) + capacity * sizeof(Vehicle);
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    const World* world = At(from, stride, indices[i]);
    World* copy = At(to, to_stride, i);
    std::memcpy(copy, world, sizeof(World) + world->count * sizeof(Vehicle));
    copy->capacity = capacity;
  }
}
