/* One air temperature out of two sensors. Needs gh_safety.h's idea of how old an air temperature may be. */
#ifndef GH_VOTE_H
#define GH_VOTE_H

#include "gh_bus.h"

#define GH_VOTE_SENSORS 2u

typedef struct {
    int32_t raw; /* 0.01 degC */
    uint32_t time_ms;
    bool good;
    bool is_new; /* nothing has been told of it */
} gh_vote_sensor;

typedef struct {
    gh_vote_sensor sensors[GH_VOTE_SENSORS];
    uint32_t told_ms;
    uint16_t limit;
    bool told;      /* something, since the start */
    bool bad_is_new;
} gh_vote;

/* `limit`: 0.01 K that two good sensors may differ by. */
void gh_vote_init(gh_vote *s, uint16_t limit);

/* What the driver of sensor 0 or 1 found. */
void gh_vote_hear(gh_vote *s, uint8_t sensor, const gh_measurement *measurement, uint32_t now_ms);

/* True at most once a second, when what it tells rests on a measurement that is new. `verdict`: GH_AIR_VERDICT_... */
bool gh_vote_step(gh_vote *s, uint32_t now_ms, gh_measurement *temperature, uint8_t *verdict);

#endif
