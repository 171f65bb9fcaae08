// The traffic of the fast world: vehicles that follow by the IDM and change lanes by MOBIL.
#ifndef IITS_MJ_KERNELS_FAST_TRAFFIC_H_
#define IITS_MJ_KERNELS_FAST_TRAFFIC_H_

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/fast_world.h"

namespace iits {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kLaneWidth = 4.0;
// Shares of the traffic's limit with which the road is filled and at which vehicles arrive.
constexpr double kMeanDesiredSpeed = 0.92, kArrivalSpeed = 0.9;
constexpr double kHardestBraking = 8.0;        // [m/s2], dry road
constexpr double kRoundPeriod = 1.0;           // between two rounds of lane changes [s]
constexpr double kChangeDuration = 3.5;        // of a lane change [s]
constexpr double kChangeInterval = 6.0;        // between two of a vehicle [s]
constexpr double kMargin = 2.0;                // free ahead and behind after a change [m]
constexpr double kCriticalSpeed = 60.0 / 3.6;  // below it lanes may pass on the right [m/s]
constexpr double kRampLength = 250.0;          // lane beside the highway [m]
constexpr double kClearFill = 40.0, kClearSpawn = 30.0;  // [m]

// A vehicle or an obstacle in the row of all, sorted by front bumpers.
struct Car {
  double front, rear, speed, desired;
  std::int64_t lane;
  const Driver* driver;
  Vehicle* vehicle;  // none for an obstacle
};

// Writes offset and lateral speed in a lane change, at a phase of 0 to 1 of its duration: a
// quintic.
inline void Place(double from, double step, double phase, double duration, double* offset,
                  double* speed) {
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
    iits::Place(v.change_from, step, phase, kChangeDuration, offset, speed);
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

  static Neighbor To(const Car& car, const Car* leader) {
    return leader ? Neighbor{leader->rear - car.front, leader->speed}
                  : Neighbor{kInfinity, car.speed};
  }

  static double Follow(const Car& car, const Neighbor& lead) {
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
    const Neighbor there = To(car, ahead);
    const double room = behind ? car.rear - behind->front : kInfinity;
    if (there.gap < kMargin || room < kMargin) return -kInfinity;
    const double after = Follow(car, there);
    if (after < -driver.safe_braking) return -kInfinity;
    const double braking = behind ? Follow(*behind, {room, car.speed}) : 0.0;
    if (braking < -driver.safe_braking) return -kInfinity;
    const Car* leader = Next(i, car.lane);
    const Neighbor here = To(car, leader);
    const double before = Follow(car, here);
    if (w.keeps_right == 0) return after - before - driver.change_threshold;
    const bool to_right = lane < car.lane;
    // Nobody overtakes the left lane's leader on the right at speed.
    const Neighbor& left = to_right ? here : there;
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

}  // namespace iits

#endif  // IITS_MJ_KERNELS_FAST_TRAFFIC_H_
