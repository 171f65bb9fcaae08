// Order of a vehicle's numbers: `COLUMNS` of iits_mj/core/vehicles.py.
#ifndef IITS_MJ_KERNELS_VEHICLE_COLUMNS_H_
#define IITS_MJ_KERNELS_VEHICLE_COLUMNS_H_

namespace iits {

enum Column {
  kX,
  kY,
  kZ,
  kYaw,
  kPitch,
  kRoll,
  kYawRate,
  kSpeed,
  kAcceleration,
  kLateralSpeed,
  kStation,
  kOffset,
  kLength,
  kWidth,
  kHeight,
  kColumns,
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_VEHICLE_COLUMNS_H_
