#include "gh_hcsr04.h"

#include <string.h>

#include "gh_measure.h"

#define PERIOD_MS 1000u
#define WINDOW_MS 61u       /* datasheet: a cycle of 60 ms or more, so that no echo of the shot before is heard */
#define TRIGGER_US 10u      /* datasheet: a trigger of at least 10 us */
#define ECHO_MIN_US 100u    /* datasheet: from 2 cm; 105 us at the 380 m/s of 80 degC */
#define ECHO_MAX_US 30000u  /* datasheet: to 4 m, 25.1 ms at the 319 m/s of -20 degC; after 38 ms it gives up */
#define FARTHEST_MM 4500u
#define SPEED 34320         /* 0.01 m/s: of sound, 343.2 m/s in air of 20 degC */
#define SPEED_AT_ZERO 33130 /* 0.01 m/s: c = 331.3 m/s + 0.606 m/s a degree */
#define SPEED_PER_MILLE 606 /* 0.01 m/s in 1000 times 0.01 degC */
#define MARGIN_PCT 5u

void gh_hcsr04_init(gh_hcsr04 *s, const gh_lines *lines, bool *listening, uint8_t trigger, uint8_t echo,
                    uint16_t empty_mm, uint16_t full_mm)
{
    memset(s, 0, sizeof *s);
    s->lines = lines;
    s->listening = listening;
    s->trigger = trigger;
    s->echo = echo;
    s->empty_mm = empty_mm;
    s->full_mm = full_mm;
    lines->drive(lines->context, trigger, GH_LEVEL_LOW);
    lines->drive(lines->context, echo, GH_LEVEL_RELEASED);
}

/* There and back: us * 0.01 m/s is 10 nm, half of it the distance. In 0.1 mm. */
static int32_t distance(uint16_t echo_us, int32_t temp_air)
{
    bool known = temp_air != GH_NO_VALUE && temp_air >= GH_AIR_MIN && temp_air <= GH_AIR_MAX;
    int32_t speed = known ? SPEED_AT_ZERO + temp_air * SPEED_PER_MILLE / 1000 : SPEED;
    return (int32_t)((uint32_t)echo_us * (uint32_t)speed / 20000u);
}

/* 0 when nothing was heard, or anything but the one echo of one shot: a loose cable. */
static uint16_t heard_echo(const gh_hcsr04 *s)
{
    uint16_t echo_us[1] = {0};
    bool one = s->lines->heard(s->lines->context, echo_us, 1) == 1;
    return one && echo_us[0] >= ECHO_MIN_US && echo_us[0] <= ECHO_MAX_US ? echo_us[0] : 0;
}

/* A missing echo counts as one from infinitely far, so that one shot of three may be false or missing. After a fault,
 * and at first, all three must be there. */
static bool judge(gh_hcsr04 *s, uint16_t echo_us, int32_t temp_air, gh_measurement *level)
{
    uint16_t sorted[GH_HCSR04_SHOTS];
    uint8_t missing = 0;
    s->echoes_us[s->place] = echo_us;
    s->place = (uint8_t)((s->place + 1u) % GH_HCSR04_SHOTS);
    for (uint8_t i = 0; i < GH_HCSR04_SHOTS; i++) {
        sorted[i] = s->echoes_us[i] > 0 ? s->echoes_us[i] : UINT16_MAX;
        missing = (uint8_t)(missing + (s->echoes_us[i] == 0));
    }
    if (echo_us == 0 && missing > 1) {
        s->settled = false;
        *level = gh_bad(GH_QUALITY_FAULT);
        return true;
    }
    if (missing > (s->settled ? 1 : 0)) {
        return false;
    }
    s->settled = true;
    if (s->empty_mm > FARTHEST_MM || s->empty_mm <= s->full_mm) {
        *level = gh_bad(GH_QUALITY_FAULT);
    } else {
        int32_t found = distance(gh_median(sorted, GH_HCSR04_SHOTS), temp_air);
        *level = gh_level_between(found, s->empty_mm * INT32_C(10), s->full_mm * INT32_C(10), MARGIN_PCT);
    }
    return true;
}

bool gh_hcsr04_step(gh_hcsr04 *s, uint32_t now_ms, int32_t temp_air, gh_measurement *level)
{
    const gh_lines *lines = s->lines;
    if (s->shooting) {
        if (!s->waiting) { /* `now_ms` may be as old as one round of the loop: it was not when the shot was made */
            s->waiting = true;
            s->wait_ms = now_ms;
        }
        if (now_ms - s->wait_ms < WINDOW_MS) {
            return false;
        }
        s->shooting = false;
        *s->listening = false;
        return judge(s, heard_echo(s), temp_air, level);
    }
    if (*s->listening || (s->started && now_ms - s->shot_ms < PERIOD_MS)) {
        return false;
    }
    s->started = true;
    s->shot_ms = now_ms;
    if (lines->is_high(lines->context, s->echo)) { /* unplugged, or still busy with the shot before */
        return judge(s, 0, temp_air, level);
    }
    s->shooting = true;
    s->waiting = false;
    *s->listening = true;
    lines->listen(lines->context, s->echo);
    lines->pulse(lines->context, s->trigger, TRIGGER_US);
    return false;
}
