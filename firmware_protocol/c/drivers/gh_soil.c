#include "gh_soil.h"

#include <string.h>

#include "gh_measure.h"

#define PERIOD_MS 1000u
#define COUNTS_MIN 4u    /* below: the cable is cut and the resistor pulls down, or the output is shorted to ground */
#define COUNTS_MAX 1019u /* above: shorted to the supply */
#define MARGIN_PCT 10u   /* soil packs differently each time; further out somebody moved the probe */

void gh_soil_init(gh_soil *s, const gh_lines *lines, uint8_t channel, uint16_t dry, uint16_t wet)
{
    memset(s, 0, sizeof *s);
    s->lines = lines;
    s->channel = channel;
    s->dry = dry;
    s->wet = wet;
}

static gh_measurement moisture_from(uint16_t counts, const gh_soil *s)
{
    if (counts < COUNTS_MIN || counts > COUNTS_MAX) {
        return gh_bad(GH_QUALITY_FAULT);
    }
    return gh_level_between(counts, s->dry, s->wet, MARGIN_PCT);
}

bool gh_soil_step(gh_soil *s, uint32_t now_ms, gh_measurement *moisture)
{
    if (s->started && s->taken == 0 && now_ms - s->start_ms < PERIOD_MS) {
        return false;
    }
    if (s->taken == 0) {
        s->started = true;
        s->start_ms = now_ms;
    }
    s->samples[s->taken++] = s->lines->analog(s->lines->context, s->channel);
    if (s->taken < GH_SOIL_SAMPLES) {
        return false;
    }
    s->taken = 0;
    *moisture = moisture_from(gh_median(s->samples, GH_SOIL_SAMPLES), s);
    return true;
}
