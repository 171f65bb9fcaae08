// Marks the functions that Python calls through ctypes.
#ifndef IITS_MJ_KERNELS_KERNELS_H_
#define IITS_MJ_KERNELS_KERNELS_H_

#define IITS_KERNEL extern "C" __attribute__((visibility("default")))

#endif  // IITS_MJ_KERNELS_KERNELS_H_
