/* HC-SR04: ultrasonic distance to the water, from above. Datasheet: Elecfreaks, "Ultrasonic Ranging Module HC-SR04". */
#ifndef GH_HCSR04_H
#define GH_HCSR04_H

#include "gh_bus.h"

#define GH_HCSR04_SHOTS 3u /* the median of them, so that one may be false */

typedef struct {
    const gh_lines *lines;
    bool *listening;
    uint32_t shot_ms;
    uint32_t wait_ms; /* when the wait for the echo began */
    uint16_t empty_mm, full_mm;
    uint16_t echoes_us[GH_HCSR04_SHOTS]; /* 0: no echo */
    uint8_t trigger, echo;
    uint8_t place; /* of the next one in echoes_us */
    bool started;
    bool shooting;
    bool waiting;
    bool settled; /* a level has been told since the last fault */
} gh_hcsr04;

/* `empty_mm` and `full_mm`: from the sensor to the water in an empty and in a full tank, empty_mm > full_mm, at most
 * 4500; otherwise every measurement is a fault. The sensor sees nothing nearer than 20 mm.
 *
 * `listening` belongs to the lines: one flag, false at first, for all drivers that listen on them, because the lines
 * listen to one pin at a time. Call no step that keeps interrupts off (1-Wire) while it is true: edges are timed late
 * by as much. */
void gh_hcsr04_init(gh_hcsr04 *s, const gh_lines *lines, bool *listening, uint8_t trigger, uint8_t echo,
                    uint16_t empty_mm, uint16_t full_mm);

/* `temp_air`: 0.01 degC, GH_NO_VALUE when it is not known. True at most once a second: tank level [0.0001 of full]. */
bool gh_hcsr04_step(gh_hcsr04 *s, uint32_t now_ms, int32_t temp_air, gh_measurement *level);

#endif
