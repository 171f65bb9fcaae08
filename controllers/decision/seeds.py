"""Where the seeds of training, validation and test trips begin; no two of the three meet.

Training draws from the first, the choice of a policy from the second. Only figures that are to be
believed come from the third: no decision may rest on them.
"""

from __future__ import annotations

TRAINING_SEEDS, VALIDATION_SEEDS, TEST_SEEDS = 1_000_000, 2_000_000, 3_000_000
# Each of the three has as many seeds as lie between two beginnings.
SEEDS_EACH = 1_000_000
