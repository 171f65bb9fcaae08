// Accelerations of car following and the motion of a leader.
#include "kernels/following.h"

#include "kernels/kernels.h"

using iits::Following;
using iits::Lead;

IITS_KERNEL double iits_idm_acceleration(const Following* config, double speed, double desired,
                                         double gap, double lead_speed) {
  return config->Idm(speed, desired, gap, lead_speed);
}

IITS_KERNEL double iits_follow_acceleration(const Following* config, double speed, double desired,
                                            double gap, double lead_speed,
                                            double lead_acceleration) {
  return config->Follow(speed, desired, gap, lead_speed, lead_acceleration);
}

IITS_KERNEL std::ptrdiff_t iits_stays_free(const Following* config, double speed, double gap,
                                           double lead_speed, double seconds) {
  return config->StaysFree(speed, gap, lead_speed, seconds);
}

// Writes the distance driven since now and the speed.
IITS_KERNEL void iits_lead_at(double speed, double acceleration, double time, double* found) {
  Lead{0.0, speed, acceleration, 0.0}.At(time, found, found + 1);
}
