#include "gh_measure.h"

#define FULL_LEVEL 10000 /* 0.0001 of full */

gh_measurement gh_good(int32_t raw)
{
    return (gh_measurement){raw, GH_QUALITY_GOOD};
}

gh_measurement gh_bad(uint8_t quality)
{
    return (gh_measurement){GH_NO_VALUE, quality};
}

uint16_t gh_median(uint16_t *values, uint8_t count)
{
    for (uint8_t i = 1; i < count; i++) {
        uint16_t value = values[i];
        uint8_t place = i;
        for (; place > 0 && values[place - 1] > value; place--) {
            values[place] = values[place - 1];
        }
        values[place] = value;
    }
    return values[count / 2];
}

gh_measurement gh_level_between(int32_t value, int32_t at_empty, int32_t at_full, uint8_t margin_pct)
{
    int32_t span = at_full - at_empty;
    int32_t above = value - at_empty;
    if (span == 0) {
        return gh_bad(GH_QUALITY_FAULT);
    }
    if (span < 0) {
        span = -span;
        above = -above;
    }
    if (above * 100 < -span * margin_pct || (above - span) * 100 > span * margin_pct) {
        return gh_bad(GH_QUALITY_RANGE);
    }
    if (above < 0) {
        return gh_good(0);
    }
    return gh_good(above > span ? FULL_LEVEL : above * FULL_LEVEL / span);
}
