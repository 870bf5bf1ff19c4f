/* Capacitive soil probe with an analog output. The probe's output needs a resistor of about 1 Mohm to ground at the
 * board: without it the pin of a cut cable floats at any voltage, and no driver can notice. */
#ifndef GH_SOIL_H
#define GH_SOIL_H

#include "gh_bus.h"

#define GH_SOIL_SAMPLES 5u /* the median of them, so that two may be disturbed */

typedef struct {
    const gh_lines *lines;
    uint32_t start_ms;
    uint16_t dry, wet; /* counts in dry air or soil, and in water or soaked soil */
    uint16_t samples[GH_SOIL_SAMPLES];
    uint8_t channel;
    uint8_t taken;
    bool started;
} gh_soil;

/* Either point may be the larger one. The same number for both is a fault in every measurement. */
void gh_soil_init(gh_soil *s, const gh_lines *lines, uint8_t channel, uint16_t dry, uint16_t wet);

/* True once a second: moisture 0..10000 [0.0001] between the two points. */
bool gh_soil_step(gh_soil *s, uint32_t now_ms, gh_measurement *moisture);

#endif
