/* What several drivers need to make a measurement out of numbers. */
#ifndef GH_MEASURE_H
#define GH_MEASURE_H

#include "gh_bus.h"

gh_measurement gh_good(int32_t raw);
/* No number, and the reason: a GH_QUALITY_... other than GOOD. */
gh_measurement gh_bad(uint8_t quality);

/* Sorts `values` and returns the middle one; `count` is odd. */
uint16_t gh_median(uint16_t *values, uint8_t count);

/* Level on the straight line through two calibrated points: 0 at `at_empty`, 10000 at `at_full`. Clipped up to
 * `margin_pct` of the span beyond either point, GH_QUALITY_RANGE further out, GH_QUALITY_FAULT when the points are the
 * same. No two arguments may lie further apart than 200 000. */
gh_measurement gh_level_between(int32_t value, int32_t at_empty, int32_t at_full, uint8_t margin_pct);

#endif
