// A rule's decision on a lane change, for the full chain.
#include "kernels/decision_rules.h"

#include "kernels/kernels.h"

IITS_KERNEL std::ptrdiff_t iits_rule_decision(const iits::Rule* rule, const iits::Situation* at,
                                              const iits::RuleModel* model) {
  return rule->Decide(*at, *model);
}
