#include "gh_float.h"

#include <string.h>

#include "gh_measure.h"

#define REPORT_PERIOD_MS 1000u
#define WATER_LEVEL 10000 /* 0.0001 of full */

void gh_float_init(gh_float *s, const gh_lines *lines, uint8_t pin, bool closed_is_water)
{
    memset(s, 0, sizeof *s);
    s->lines = lines;
    s->pin = pin;
    s->closed_is_water = closed_is_water;
    lines->drive(lines->context, pin, GH_LEVEL_RELEASED);
}

bool gh_float_step(gh_float *s, uint32_t now_ms, gh_measurement *level)
{
    bool closed = !s->lines->is_high(s->lines->context, s->pin);
    if (!s->started || closed != s->closed) {
        s->started = true;
        s->closed = closed;
        s->change_ms = now_ms;
    }
    if (now_ms - s->change_ms >= GH_FLOAT_STEADY_MS) {
        s->water = s->closed == s->closed_is_water;
        if (!s->known) {
            s->known = true;
            s->report_ms = now_ms - REPORT_PERIOD_MS;
        }
    }
    if (!s->known || now_ms - s->report_ms < REPORT_PERIOD_MS) {
        return false;
    }
    s->report_ms = now_ms;
    *level = gh_good(s->water ? WATER_LEVEL : 0);
    return true;
}
