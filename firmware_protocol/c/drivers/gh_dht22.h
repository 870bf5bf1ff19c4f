/* DHT22 (AM2302): air temperature and humidity over one wire. Datasheet: Aosong, "AM2302". */
#ifndef GH_DHT22_H
#define GH_DHT22_H

#include "gh_bus.h"

typedef enum { GH_DHT22_IDLE, GH_DHT22_CALLING, GH_DHT22_LISTENING } gh_dht22_state;

typedef struct {
    const gh_lines *lines;
    bool *listening;
    uint32_t start_ms;  /* of the last reading */
    uint32_t wait_ms;   /* when the wait of this state began */
    uint8_t pin;
    uint8_t state;
    bool waiting;
    bool fresh;     /* the part answered the call before: what it tells now is from then */
    bool was_wrong; /* the last checksum was */
} gh_dht22;

/* The pin needs a pull-up of 5 to 10 kohm; the one in the board is too weak for a long cable. `listening`: see
 * gh_hcsr04.h. `now_ms` because the part takes 2 s after power-on until it answers. */
void gh_dht22_init(gh_dht22 *s, const gh_lines *lines, bool *listening, uint8_t pin, uint32_t now_ms);

/* True at most once in 2 s: 0.01 degC and 0.01 %. The step must come round within 20 ms while *listening is true. */
bool gh_dht22_step(gh_dht22 *s, uint32_t now_ms, gh_measurement *temperature, gh_measurement *humidity);

#endif
