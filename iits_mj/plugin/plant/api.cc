// The planar plant for Python: iits_mj/truck/plant.py.
#include <cstring>
#include <memory>
#include <string>

#include "plugin/plant/plant.h"

#define IITS_EXPORT extern "C" __attribute__((visibility("default")))

IITS_EXPORT void* iits_plant_create(const mjModel* m, const char* prefix, int motion, char* error,
                                    int size);
void* iits_plant_create(const mjModel* m, const char* prefix, int motion, char* error, int size) {
  std::string message;
  if (m->nuserdata < static_cast<int>(sizeof(iits::PlantState) / sizeof(mjtNum))) {
    message = "the model has too little userdata";
  }
  auto plant = message.empty() ? std::make_unique<iits::Plant>(
                                     m, prefix, static_cast<iits::Motion>(motion), &message)
                               : nullptr;
  std::strncpy(error, message.c_str(), size - 1);
  error[size - 1] = 0;
  return message.empty() ? plant.release() : nullptr;
}

IITS_EXPORT void iits_plant_delete(void* plant);
void iits_plant_delete(void* plant) { delete static_cast<iits::Plant*>(plant); }

IITS_EXPORT int iits_plant_state_size(void);
int iits_plant_state_size(void) { return sizeof(iits::PlantState) / sizeof(mjtNum); }

// Plant::Step of each of the `size` data.
IITS_EXPORT void iits_plant_step(const void* plant, const mjModel* m, mjData* const* data, int size,
                                 int count, int observe, int* alive);
void iits_plant_step(const void* plant, const mjModel* m, mjData* const* data, int size, int count,
                     int observe, int* alive) {
  for (int i = 0; i < size; ++i) {
    alive[i] = static_cast<const iits::Plant*>(plant)->Step(m, data[i], count, observe != 0);
  }
}
