"""What decides about edges: each number with its source."""

# Overshoot of both plateaus together, share of the step, from which it counts: bins of an eighth of a pixel and
# plateaus of a slightly curved light leave up to 0.4 % on drawn edges (benchmarks.studies.strangers_edges).
MIN_OVERSHOOT = 0.01
# The same in standard errors: chance among ten windows a side makes five in a hundred thousand edges.
OVERSHOOT_SD = 5.0
# By how much neighbours lower the sum of the noise's correlation from where on sharpening is told: as drawn edges of
# white noise never do, and an amount of 0.3 and more does (benchmarks.studies.strangers_edges).
MIN_OPPOSED = 0.1
# The same in standard errors: chance makes three in a hundred thousand edges.
OPPOSED_SD = 4.0
