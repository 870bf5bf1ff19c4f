/* Float switch between a pin and ground; the board's pull-up is the only supply. Wire it so that the open switch is the
 * careful answer: a cut cable looks like an open switch, and no driver can tell them apart. */
#ifndef GH_FLOAT_H
#define GH_FLOAT_H

#include "gh_bus.h"

typedef struct {
    const gh_lines *lines;
    uint32_t change_ms; /* when the pin was last seen at another level */
    uint32_t report_ms;
    uint8_t pin;
    bool closed_is_water;
    bool closed;  /* as last seen */
    bool water;   /* as last seen for GH_FLOAT_STEADY_MS */
    bool known;   /* `water` holds something */
    bool started; /* the pin has been seen */
} gh_float;

#define GH_FLOAT_STEADY_MS 2000u /* waves from the pump and the fan are shorter */

void gh_float_init(gh_float *s, const gh_lines *lines, uint8_t pin, bool closed_is_water);

/* True once a second as soon as the switch has once kept still for 2 s: level 0 or 10000 [0.0001], always GOOD. A
 * switch that moves keeps the level that it had. */
bool gh_float_step(gh_float *s, uint32_t now_ms, gh_measurement *level);

#endif
