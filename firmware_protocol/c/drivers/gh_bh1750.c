#include "gh_bh1750.h"

/* BH1750FVI datasheet rev D: "Instruction Set Architecture". Each needs a stop condition of its own. */
#define POWER_ON 0x01u
#define CONTINUOUSLY_H_RESOLUTION 0x10u

/* Pauses [ms]: the longest time of the datasheet, rounded up, and one, see gh_i2c_part_next. */
#define MEASURING_MS 181u /* BH1750FVI datasheet rev D: "Electrical Characteristics", H-Resolution Mode: 180 ms */
#define REST_MS 815u      /* so that the values come once a second */

#define SATURATED UINT16_MAX
#define FULL GH_SENSOR_REPORT_LIGHT_MAX
/* 1.2 counts are 1 lux (BH1750FVI datasheet rev D: "Measurement Accuracy", typical): a count is 10000 / 1.2 = 25000 / 3
 * of the signal's unit, by full_lux. */
#define UNITS_PER_3_COUNTS 25000u

/* Each measurement starts the part anew: one that lost its power for a moment would else answer 0, as it does in the
 * dark. */
enum { WAKE, START, READ };

void gh_bh1750_init(gh_bh1750 *bh1750, const gh_i2c *bus, uint8_t address, uint16_t full_lux)
{
    gh_i2c_part_init(&bh1750->part, bus, address, 0);
    bh1750->full_lux = full_lux > 0 ? full_lux : 1;
}

static bool send(gh_bh1750 *bh1750, uint8_t command, uint8_t next, uint16_t pause_ms)
{
    gh_i2c_part_next(&bh1750->part, next, pause_ms);
    return gh_i2c_part_transfer(&bh1750->part, &command, 1, NULL, 0) == GH_BUS_OK;
}

static bool report_fault(gh_bh1750 *bh1750, gh_measurement *light)
{
    *light = gh_i2c_part_fault(&bh1750->part);
    return true;
}

static bool report(const gh_bh1750 *bh1750, uint16_t counts, gh_measurement *light)
{
    uint32_t divisor = (uint32_t)bh1750->full_lux * 3u;
    uint32_t units = ((uint32_t)counts * UNITS_PER_3_COUNTS + divisor / 2u) / divisor; /* halves are rounded up */
    bool inside = counts != SATURATED && units <= FULL;
    light->raw = inside ? (int32_t)units : GH_NO_VALUE;
    light->quality = inside ? GH_QUALITY_GOOD : GH_QUALITY_RANGE;
    return true;
}

bool gh_bh1750_step(gh_bh1750 *bh1750, uint32_t now_ms, gh_measurement *light)
{
    if (!gh_i2c_part_due(&bh1750->part, now_ms)) {
        return false;
    }
    switch (bh1750->part.task) {
    case WAKE:
        return !send(bh1750, POWER_ON, START, 0) && report_fault(bh1750, light);
    case START:
        return !send(bh1750, CONTINUOUSLY_H_RESOLUTION, READ, MEASURING_MS) && report_fault(bh1750, light);
    default: { /* READ */
        uint8_t in[2];
        if (gh_i2c_part_transfer(&bh1750->part, NULL, 0, in, sizeof in) != GH_BUS_OK) {
            return report_fault(bh1750, light);
        }
        gh_i2c_part_next(&bh1750->part, WAKE, REST_MS);
        return report(bh1750, (uint16_t)((uint16_t)in[0] << 8 | in[1]), light);
    }
    }
}
