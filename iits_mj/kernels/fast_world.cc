// The fast world: a point-mass truck on a highway among vehicles that follow by the IDM and change
// lanes by MOBIL. The numpy form in tests/controllers/decision/numpy_world.py gives the same trips.
#include "kernels/fast_world.h"

#include <cstring>
#include <vector>

#include "kernels/kernels.h"

using namespace iits;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kPi = 3.14159265358979323846;
constexpr double kLaneWidth = 4.0;
constexpr double kGravity = 9.81;
// Shares of the traffic's limit with which the road is filled and at which vehicles arrive.
constexpr double kMeanDesiredSpeed = 0.92, kArrivalSpeed = 0.9;
constexpr double kHardestBraking = 8.0;        // of the traffic [m/s2], dry road
constexpr double kRoundPeriod = 1.0;           // between two rounds of lane changes [s]
constexpr double kChangeDuration = 3.5;        // of the traffic's lane changes [s]
constexpr double kChangeInterval = 6.0;        // between two of a vehicle [s]
constexpr double kMargin = 2.0;                // free ahead and behind after a change [m]
constexpr double kCriticalSpeed = 60.0 / 3.6;  // below it lanes may pass on the right [m/s]
constexpr double kRampLength = 250.0;          // lane beside the highway [m]
constexpr double kClearFill = 40.0, kClearSpawn = 30.0;  // [m]
// Share of a change during which the truck also occupies the lane that it leaves.
constexpr double kLeaves = 0.7;
constexpr double kShortestChange = 6.0;  // [s]; up to 3 s more
// The observation: ranges and step of the road left [m].
constexpr double kRangeAhead = 250.0, kRangeBehind = 50.0, kProbe = 25.0;
constexpr int kBehind = 2, kAhead = 6;
// A body is in a lane when it reaches at least this far into it, within a distance [m].
constexpr double kIntrusion = 0.3, kLaneReach = 250.0;
constexpr double kPeriods[] = {1900.0, 730.0};  // of the hills [m]

// A vehicle or an obstacle in the row of all, sorted by front bumpers.
struct Car {
  double front, rear, speed, desired;
  std::int64_t lane;
  const Driver* driver;
  Vehicle* vehicle;  // none for an obstacle
};

struct Lead {
  double gap, speed;
};

// Writes offset and lateral speed in a lane change, at a phase of 0 to 1 of its duration: a quintic.
void Place(double from, double step, double phase, double duration, double* offset, double* speed) {
  const double square = phase * phase, rest = 1.0 - phase;
  *offset = from + step * (square * phase * (10.0 - 15.0 * phase + 6.0 * square));
  *speed = step * (30.0 * square * (rest * rest) / duration);
}

// The traffic of one world.
class Traffic {
 public:
  Traffic(World* world, const Laws* laws) : w(*world), laws_(*laws) {}

  void Start() {
    w.count = w.spawned = 0;
    w.clock = w.round_due = 0.0;
    for (int lane = 0; lane < w.lanes; ++lane) w.most_ahead[lane] = 0.5 * Headway();
    for (int lane = 0; lane < w.lanes; ++lane) w.most_behind[lane] = 0.5 * Headway();
    std::copy_n(w.most_ahead, kLanesMost, w.wait_ahead);
    std::copy_n(w.most_behind, kLanesMost, w.wait_behind);
  }

  void Fill(const Obstacle& truck) {
    for (int lane = 0; lane < w.lanes; ++lane) {
      double front = truck.front - w.window_behind;
      for (;;) {
        front += Headway();
        if (front > truck.front + w.window_ahead) break;
        const bool near =
            truck.front - truck.length - kClearFill < front && front < truck.front + kClearFill;
        if (!(near && lane == truck.lane)) Spawn(lane, front);
      }
    }
  }

  void Step(const Obstacle* obstacles, std::ptrdiff_t count) {
    const double dt = w.timestep;
    w.clock += dt;
    if (w.clock >= w.round_due) {
      w.round_due += kRoundPeriod;
      Arrive(obstacles[0]);
      Gather(obstacles, count);
      ChangeLanes();
    } else {
      Gather(obstacles, count);
    }
    Move(dt);
    Exchange(obstacles[0]);
  }

  void Spawn(int lane, double front) {
    const double share = w.random.Uniform();
    int kind = 0;
    while (kind < kKinds - 1 && laws_.shares[kind] <= share) ++kind;
    const Driver& driver = laws_.kinds[kind];
    const double desired = DesiredSpeed(kind);
    double speed = desired;
    const Vehicle *leader = Ahead(front, lane), *follower = Behind(front, lane);
    if (leader && leader->front - leader->length - front < 2.0 * speed) {
      speed = std::min(speed, leader->speed);
    }
    // The vehicle may be too long for the gap.
    if (follower && front - driver.length - follower->front < driver.minimum_gap) return;
    if (w.count == w.capacity) return;
    ++w.spawned;
    Vehicle* place = std::upper_bound(
        begin(), end(), front, [](double value, const Vehicle& v) { return value < v.front; });
    std::copy_backward(place, end(), end() + 1);
    ++w.count;
    *place = {w.spawned, lane,          kind,    front,      speed,
              0.0,       driver.length, desired, -kInfinity, lane * kLaneWidth};
  }

  void Place(const Vehicle& v, double* offset, double* speed) const {
    const double phase = std::min(std::max((w.clock - v.change_time) / kChangeDuration, 0.0), 1.0);
    const double step = static_cast<double>(v.lane) * kLaneWidth - v.change_from;
    ::Place(v.change_from, step, phase, kChangeDuration, offset, speed);
  }

  // Draws the hidden wishes of all drivers again; none wishes to drive slower than it does.
  void Redraw() {
    for (Vehicle& v : *this) v.desired = std::max(v.speed, DesiredSpeed(static_cast<int>(v.kind)));
  }

  const Vehicle* Ahead(double front, std::int64_t lane) const {
    for (Vehicle& v : *this) {
      if (v.front > front && v.lane == lane) return &v;
    }
    return nullptr;
  }

  const Vehicle* Behind(double front, std::int64_t lane) const {
    const Vehicle* found = nullptr;
    for (Vehicle& v : *this) {
      if (v.front > front) break;
      if (v.lane == lane) found = &v;
    }
    return found;
  }

  Vehicle* begin() const { return w.vehicles(); }
  Vehicle* end() const { return w.vehicles() + w.count; }

 private:
  // A distance between fronts [m]: Poisson arrivals, enough to drive at the limit.
  double Headway() {
    if (!(w.spawn_probability > 0.0)) return kInfinity;
    const double mean = kMeanDesiredSpeed * w.traffic_speed / w.spawn_probability;
    const Driver& car = laws_.kinds[0];
    const double least = car.length + car.minimum_gap + 1.5 * w.traffic_speed;
    return std::max(least, mean * w.random.Exponential());
  }

  double DesiredSpeed(int kind) {
    const Driver& driver = laws_.kinds[kind];
    const double factor =
        driver.desired_speed_mean + driver.desired_speed_deviation * w.random.Normal();
    const double limit =
        laws_.slow[kind] != 0.0 ? std::min(w.traffic_speed, w.truck_speed_limit) : w.traffic_speed;
    return limit * std::min(1.0, std::max(driver.desired_speed_low, factor));
  }

  bool Free(int lane, double front) const {
    for (const Vehicle& v : *this) {
      if (v.lane == lane && std::abs(v.front - front) < kClearSpawn) return false;
    }
    return true;
  }

  // Calls a function with the beginning of every ramp between two stations.
  template <typename Call>
  void EachRamp(double low, double high, Call call) {
    if (!(w.ramp_probability > 0.0)) return;
    for (double k = std::max(1.0, std::floor(low / w.ramp_interval)); k * w.ramp_interval < high;
         ++k) {
      if (k * w.ramp_interval > low) call(k * w.ramp_interval);
    }
  }

  // Vehicles at the beginnings of the ramps, once a second.
  void Arrive(const Obstacle& truck) {
    EachRamp(truck.front - w.window_behind, truck.front + w.window_ahead, [this](double start) {
      if (w.random.Uniform() < w.ramp_probability && Free(-1, start)) Spawn(-1, start);
    });
  }

  // Makes the row of all vehicles and obstacles.
  void Gather(const Obstacle* obstacles, std::ptrdiff_t count) {
    row_.clear();
    for (Vehicle& v : *this) {
      const Driver* driver = &laws_.kinds[v.kind];
      row_.push_back({v.front, v.front - v.length, v.speed, v.desired, v.lane, driver, &v});
    }
    for (std::ptrdiff_t i = 0; i < count; ++i) Insert(obstacles[i]);
    // A ramp's end is a stopped vehicle.
    const double low = obstacles[0].front - w.window_behind - kRampLength;
    EachRamp(low, obstacles[0].front + w.window_ahead,
             [this](double start) { Insert({start + kRampLength, 0.0, 0.0, -1}); });
  }

  void Insert(const Obstacle& o) {
    if (o.lane >= w.lanes) return;
    const auto place = std::upper_bound(row_.begin(), row_.end(), o.front,
                                        [](double front, const Car& c) { return front < c.front; });
    // The truck keeps its speed.
    row_.insert(place, {o.front, o.front - o.length, o.speed, std::max(o.speed, 1.0), o.lane,
                        &laws_.kinds[kTruckKind], nullptr});
  }

  // One round of MOBIL, in the order of the vehicles' numbers; each sees the changes before it.
  void ChangeLanes() {
    order_.clear();
    for (std::size_t i = 0; i < row_.size(); ++i) {
      const Vehicle* v = row_[i].vehicle;
      if (v && w.clock - v->change_time > kChangeInterval) order_.push_back(i);
    }
    std::sort(order_.begin(), order_.end(), [this](std::size_t a, std::size_t b) {
      return row_[a].vehicle->serial < row_[b].vehicle->serial;
    });
    for (const std::size_t i : order_) {
      Car& car = row_[i];
      double best = 0.0;
      std::int64_t target = car.lane;
      for (const std::int64_t lane : {car.lane - 1, car.lane + 1}) {
        if (lane < 0 || lane >= w.lanes) continue;
        const double gain = Gain(i, lane);
        if (gain > best) {
          best = gain;
          target = lane;
        }
      }
      if (target == car.lane) continue;
      car.vehicle->change_from = static_cast<double>(car.lane) * kLaneWidth;
      car.vehicle->change_time = w.clock;
      car.vehicle->lane = car.lane = target;
    }
  }

  const Car* Next(std::size_t i, std::int64_t lane) const {
    while (++i < row_.size()) {
      if (row_[i].lane == lane) return &row_[i];
    }
    return nullptr;
  }

  const Car* Last(std::size_t i, std::int64_t lane) const {
    while (i-- > 0) {
      if (row_[i].lane == lane) return &row_[i];
    }
    return nullptr;
  }

  static Lead To(const Car& car, const Car* leader) {
    return leader ? Lead{leader->rear - car.front, leader->speed} : Lead{kInfinity, car.speed};
  }

  static double Follow(const Car& car, const Lead& lead) {
    return car.driver->Idm(car.speed, car.desired, lead.gap, lead.speed);
  }

  // The gain of a change above its threshold [m/s2]; minus infinity if it is not safe.
  //   keep right  to the right   a~_c^eur - a_c + p (a~_o - a_o) > a_th - a_bias
  //               to the left    a~_c - a_c^eur + p (a~_n - a_n) > a_th + a_bias
  //   else        a~_c - a_c > a_th
  double Gain(std::size_t i, std::int64_t lane) const {
    const Car& car = row_[i];
    const Driver& driver = *car.driver;
    const Car *ahead = Next(i, lane), *behind = Last(i, lane);
    const Lead there = To(car, ahead);
    const double room = behind ? car.rear - behind->front : kInfinity;
    if (there.gap < kMargin || room < kMargin) return -kInfinity;
    const double after = Follow(car, there);
    if (after < -driver.safe_braking) return -kInfinity;
    const double braking = behind ? Follow(*behind, {room, car.speed}) : 0.0;
    if (braking < -driver.safe_braking) return -kInfinity;
    const Car* leader = Next(i, car.lane);
    const Lead here = To(car, leader);
    const double before = Follow(car, here);
    if (w.keeps_right == 0) return after - before - driver.change_threshold;
    const bool to_right = lane < car.lane;
    // Nobody overtakes the left lane's leader on the right at speed.
    const Lead& left = to_right ? here : there;
    const bool bound =
        left.gap < kInfinity && car.speed > left.speed && left.speed > kCriticalSpeed;
    const double lesser = bound ? std::min(before, after) : 0.0;
    double gain, bias, others;
    if (to_right) {
      gain = (bound ? lesser : after) - before;
      bias = driver.keep_right_bias;
      const Car* old = Last(i, car.lane);
      others =
          old ? Follow(*old, To(*old, leader)) - Follow(*old, {car.rear - old->front, car.speed})
              : 0.0;
    } else {
      gain = after - (bound ? lesser : before);
      bias = -driver.keep_right_bias;
      others = behind ? braking - Follow(*behind, To(*behind, ahead)) : 0.0;
    }
    return gain + bias + driver.politeness * others - driver.change_threshold;
  }

  void Move(double dt) {
    const Car* leader[kLanesMost + 1] = {};
    for (std::size_t i = row_.size(); i-- > 0;) {
      const Car& car = row_[i];
      const Car** ahead = &leader[car.lane + 1];
      if (Vehicle* v = car.vehicle) {
        const double wanted = std::max(Follow(car, To(car, *ahead)), -kHardestBraking);
        const double speed = std::max(0.0, v->speed + wanted * dt);
        v->front += 0.5 * (v->speed + speed) * dt;
        v->acceleration = (speed - v->speed) / dt;
        v->speed = speed;
      }
      *ahead = &car;
    }
    // The order changes seldom.
    for (Vehicle* v = begin() + 1; v < end(); ++v) {
      for (Vehicle* u = v; u > begin() && u->front < (u - 1)->front; --u) std::swap(*u, *(u - 1));
    }
  }

  // Removes vehicles that leave the window and adds those that its edges reach.
  void Exchange(const Obstacle& truck) {
    const double low = truck.front - w.window_behind, high = truck.front + w.window_ahead;
    while (w.count > 0 && !((end() - 1)->front < high + 1.0)) --w.count;
    Vehicle* kept = begin();
    while (kept < end() && !(kept->front > low - 1.0)) ++kept;
    if (kept > begin()) w.count = std::copy(kept, end(), begin()) - begin();
    // A vehicle that waits beyond an edge drives slower than the limit; if the window moves away
    // from it, its distance is at most the headway that was drawn for it.
    const double closing = (truck.speed - kArrivalSpeed * w.traffic_speed) * w.timestep;
    for (int lane = 0; lane < w.lanes; ++lane) {
      double& ahead = w.wait_ahead[lane];
      ahead = std::min(ahead - closing, w.most_ahead[lane]);
      if (ahead <= 0.0 && Free(lane, high)) {
        Spawn(lane, high);
        ahead = w.most_ahead[lane] = Headway();
      }
      double& behind = w.wait_behind[lane];
      behind = std::min(behind + closing, w.most_behind[lane]);
      if (behind <= 0.0 && Free(lane, low)) {
        Spawn(lane, low);
        behind = w.most_behind[lane] = Headway();
      }
    }
  }

  World& w;
  const Laws& laws_;
  std::vector<Car> row_;
  std::vector<std::size_t> order_;
};

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
    w.lane = w.source = 0;
    w.distance = w.driven_time = w.loss_integral = w.right_time = w.seconds = 0.0;
    w.time_gap_min = kInfinity;
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
    const bool changes = decision != 0 && refusal == 0;
    double lasts = 1.0;
    if (changes) {
      w.source = w.lane;
      w.lane -= decision;
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
    std::vector<Seen> seen;
    See(&seen);
    const Situation at{w.speed,
                       w.reference_speed,
                       w.truck_length,
                       Around(seen, w.lane),
                       Around(seen, w.lane + 1),
                       Around(seen, w.lane - 1)};
    return rule.Decide(at, laws_.rules);
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
    for (std::ptrdiff_t i = 0; i < count; ++i) {
      const Vehicle* lead = traffic_.Ahead(w.front, lanes[i].lane);
      if (!lead) continue;
      const double gap = lead->front - lead->length - w.front;
      if (lanes[i].lane == w.lane && w.speed > 1.0 && gap >= 0.0) {
        w.time_gap_min = std::min(w.time_gap_min, gap / w.speed);
      }
      wanted = std::min(wanted, following.Follow(w.speed, w.reference_speed, gap, lead->speed,
                                                 lead->acceleration));
    }
    wanted = std::min(wanted, following.Idm(w.speed, w.reference_speed, kInfinity, 0.0));
    wanted = std::max(wanted, -laws_.rules.hardest_braking);
    const double speed = std::max(0.0, w.speed + wanted * dt);
    w.front += 0.5 * (w.speed + speed) * dt;
    w.acceleration = (speed - w.speed) / dt;
    w.speed = speed;
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

  LaneAround Around(const std::vector<Seen>& seen, std::int64_t lane) const {
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
      if (gap < end->gap) *end = {gap, s.vehicle->speed};
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

// Drives by a rule until the trips end, or for some seconds.
IITS_KERNEL void iits_worlds_drive(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                   const Laws* laws, const Rule* rule, double seconds) {
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    World* world = At(rows, stride, i);
    Trip trip(world, laws);
    const double until = world->time + seconds - 1e-6;
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

// Draws the hidden wishes of all other drivers again.
IITS_KERNEL void iits_worlds_redraw(char* rows, std::ptrdiff_t stride, std::ptrdiff_t n,
                                    const Laws* laws) {
  for (std::ptrdiff_t i = 0; i < n; ++i) Traffic(At(rows, stride, i), laws).Redraw();
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
