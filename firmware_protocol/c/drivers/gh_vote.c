#include "gh_vote.h"

#include <string.h>

#include "gh_measure.h"

#define PERIOD_MS 1000u

void gh_vote_init(gh_vote *s, uint16_t limit)
{
    memset(s, 0, sizeof *s);
    s->limit = limit;
}

void gh_vote_hear(gh_vote *s, uint8_t sensor, const gh_measurement *measurement, uint32_t now_ms)
{
    if (sensor >= GH_VOTE_SENSORS) {
        return;
    }
    bool good = measurement->quality == GH_QUALITY_GOOD;
    s->sensors[sensor] = (gh_vote_sensor){measurement->raw, now_ms, good, good};
    if (!good) {
        s->bad_is_new = true;
    }
}

/* Forgotten, and not only left out, so that the clock's wrap cannot make it young again. */
static void forget_old(gh_vote *s, uint32_t now_ms)
{
    for (uint8_t i = 0; i < GH_VOTE_SENSORS; i++) {
        gh_vote_sensor *sensor = &s->sensors[i];
        if (sensor->good && now_ms - sensor->time_ms > GH_AIR_MAX_AGE_MS) {
            sensor->good = false;
            sensor->is_new = false;
            s->bad_is_new = true;
        }
    }
}

/* The difference cannot overflow: a sensor's raw value has less than 30 bits. */
static uint8_t verdict_of(const gh_vote *s)
{
    const gh_vote_sensor *sensors = s->sensors;
    if (!sensors[0].good || !sensors[1].good) {
        return sensors[0].good || sensors[1].good ? GH_AIR_VERDICT_ALONE : GH_AIR_VERDICT_NONE;
    }
    int32_t apart = sensors[0].raw - sensors[1].raw;
    return apart <= s->limit && -apart <= s->limit ? GH_AIR_VERDICT_AGREE : GH_AIR_VERDICT_APART;
}

bool gh_vote_step(gh_vote *s, uint32_t now_ms, gh_measurement *temperature, uint8_t *verdict)
{
    gh_vote_sensor *first = &s->sensors[0];
    gh_vote_sensor *second = &s->sensors[1];
    forget_old(s, now_ms);
    if (s->told && now_ms - s->told_ms < PERIOD_MS) {
        return false;
    }
    /* Of two that disagree the warmer is told: a dead sensor that shows cold would have the heater run on and hide an
     * over-temperature from the trip; one that shows warm only leaves the plants cold, which the flag reports. */
    uint8_t found = verdict_of(s);
    gh_vote_sensor *told = first->good && (!second->good || first->raw > second->raw) ? first : second;
    /* An old value told twice would count as two hot samples, and a single false one would trip the board. */
    bool rests_on_new = found == GH_AIR_VERDICT_NONE    ? s->bad_is_new
                        : found == GH_AIR_VERDICT_AGREE ? first->is_new || second->is_new
                                                 : told->is_new;
    if (!rests_on_new) {
        return false;
    }
    *verdict = found;
    *temperature = found == GH_AIR_VERDICT_NONE    ? gh_bad(GH_QUALITY_FAULT)
                   : found == GH_AIR_VERDICT_AGREE ? gh_good(second->raw + (first->raw - second->raw) / 2)
                                            : gh_good(told->raw);
    first->is_new = false;
    second->is_new = false;
    s->bad_is_new = false;
    s->told = true;
    s->told_ms = now_ms;
    return true;
}
