/* Sensirion SCD40 and SCD41: CO2, a value every 5 s. sizeof(gh_scd4x) is 13 on an AVR.
 * gh_board calls a sample stale after 3 s: give it the last value of this driver once a second, until the next. */
#ifndef GH_SCD4X_H
#define GH_SCD4X_H

#include "gh_sensirion.h"

typedef struct {
    gh_sensirion sensirion;
    uint8_t polls; /* how often the part was asked for the next measurement */
} gh_scd4x;

void gh_scd4x_init(gh_scd4x *scd4x, const gh_i2c *bus);

/* Call it every round of the loop. True: `co2` [ppm] is new; else it is left alone. */
bool gh_scd4x_step(gh_scd4x *scd4x, uint32_t now_ms, gh_measurement *co2);

#endif
