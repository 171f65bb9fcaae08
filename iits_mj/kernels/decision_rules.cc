// A rule's decision on a lane change, for the full chain.
#include "kernels/decision_rules.h"

#include "kernels/kernels.h"

IITS_KERNEL std::ptrdiff_t iits_rule_decision(const iits::Rule* rule, const iits::Situation* at,
                                              const iits::RuleModel* model) {
  return rule->Decide(*at, *model);
}

// Writes the braking that a change to the left and to the right asks of the new follower.
IITS_KERNEL void iits_imposed_braking(const iits::Situation* at, const iits::RuleModel* model,
                                      double* braking) {
  braking[0] = model->ImposedBraking(at->speed, at->left);
  braking[1] = model->ImposedBraking(at->speed, at->right);
}
