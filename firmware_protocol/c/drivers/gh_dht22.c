#include "gh_dht22.h"

#include <string.h>

#include "gh_measure.h"

#define PERIOD_MS 2000u  /* datasheet: 2 s between two readings, and after power-on */
#define CALL_MS 2u       /* datasheet: the host pulls low for 1 ms or more; two ticks are more than one */
#define ANSWER_MS 7u     /* datasheet: at most 200 us + 160 us + 40 * (55 us + 75 us) = 5.6 ms */
#define BITS 40u
#define EDGES_MIN (BITS + 1u) /* the part's presence before the bits ... */
#define EDGES_MAX (BITS + 2u) /* ... and before it the gap between our pulling low and its own */
#define PRESENCE_MIN_US 55u   /* datasheet: 75..85 us; edges are timed by an interrupt that others may hold up */
#define PRESENCE_MAX_US 105u
#define BIT_MIN_US 8u         /* datasheet: a 0 is 22..30 us high, a 1 is 68..75 us */
#define BIT_ONE_US 48u
#define BIT_MAX_US 100u       /* longer: the edges between two bits were lost */
#define SIGN 0x8000u
#define TEMPERATURE_MIN (-400) /* 0.1 degC: datasheet, measuring range */
#define TEMPERATURE_MAX 800
#define HUMIDITY_MAX 1000 /* 0.1 % */

typedef enum { ANSWER_NONE, ANSWER_WRONG, ANSWER_RIGHT } answer;

void gh_dht22_init(gh_dht22 *s, const gh_lines *lines, bool *listening, uint8_t pin, uint32_t now_ms)
{
    memset(s, 0, sizeof *s);
    s->lines = lines;
    s->listening = listening;
    s->pin = pin;
    s->start_ms = now_ms;
    lines->drive(lines->context, pin, GH_LEVEL_RELEASED);
}

static bool is_between(uint16_t value, uint16_t low, uint16_t high)
{
    return value >= low && value <= high;
}

/* ANSWER_NONE: not the pulses of such a part. ANSWER_WRONG: they are, but their checksum is not. */
static answer answer_heard(const gh_dht22 *s, uint8_t *bytes)
{
    uint16_t high_us[EDGES_MAX];
    uint8_t count = s->lines->heard(s->lines->context, high_us, EDGES_MAX);
    if (count < EDGES_MIN || count > EDGES_MAX) {
        return ANSWER_NONE;
    }
    const uint16_t *bits_us = high_us + (count - BITS);
    if (!is_between(bits_us[-1], PRESENCE_MIN_US, PRESENCE_MAX_US)) {
        return ANSWER_NONE;
    }
    memset(bytes, 0, BITS / 8u);
    for (uint8_t i = 0; i < BITS; i++) {
        if (!is_between(bits_us[i], BIT_MIN_US, BIT_MAX_US)) {
            return ANSWER_NONE;
        }
        bytes[i / 8u] = (uint8_t)((bytes[i / 8u] << 1) | (bits_us[i] > BIT_ONE_US));
    }
    if ((uint8_t)(bytes[0] + bytes[1] + bytes[2] + bytes[3]) != bytes[4]) {
        return ANSWER_WRONG;
    }
    /* 0.0 % at 0.0 degC has the right checksum, and is what a part without power in its sensor tells. */
    return (bytes[0] | bytes[1] | bytes[2] | bytes[3]) == 0 ? ANSWER_NONE : ANSWER_RIGHT;
}

/* From 0.1 to 0.01 of the unit. */
static gh_measurement measurement(int32_t tenths, int32_t low, int32_t high)
{
    return tenths < low || tenths > high ? gh_bad(GH_QUALITY_RANGE) : gh_good(tenths * 10);
}

static bool fail(gh_dht22 *s, gh_measurement *temperature, gh_measurement *humidity)
{
    s->fresh = false;
    *temperature = gh_bad(GH_QUALITY_FAULT);
    *humidity = *temperature;
    return true;
}

/* The part answers with what it measured at the call before. The first answer, at start or after a silence, may be
 * hours old: it is not told. One wrong checksum is a disturbance, two in a row are a fault. */
static bool judge(gh_dht22 *s, gh_measurement *temperature, gh_measurement *humidity)
{
    uint8_t bytes[BITS / 8u];
    answer found = answer_heard(s, bytes);
    bool wrong_again = s->was_wrong && found == ANSWER_WRONG;
    s->was_wrong = found == ANSWER_WRONG;
    if (found == ANSWER_NONE || wrong_again) {
        return fail(s, temperature, humidity);
    }
    if (found == ANSWER_WRONG) {
        return false;
    }
    if (!s->fresh) {
        s->fresh = true;
        return false;
    }
    uint16_t word = (uint16_t)((bytes[2] << 8) | bytes[3]); /* sign and magnitude, not two's complement */
    int32_t magnitude = word & (SIGN - 1u);
    *temperature = measurement((word & SIGN) != 0 ? -magnitude : magnitude, TEMPERATURE_MIN, TEMPERATURE_MAX);
    *humidity = measurement((uint16_t)((bytes[0] << 8) | bytes[1]), 0, HUMIDITY_MAX);
    return true;
}

static void enter(gh_dht22 *s, gh_dht22_state state)
{
    s->state = (uint8_t)state;
    s->waiting = false;
}

/* From the first call on: `now_ms` may be as old as one round of the loop, so it is not when the state began. */
static bool has_waited(gh_dht22 *s, uint32_t now_ms, uint32_t wait_ms)
{
    if (!s->waiting) {
        s->waiting = true;
        s->wait_ms = now_ms;
    }
    return now_ms - s->wait_ms >= wait_ms;
}

bool gh_dht22_step(gh_dht22 *s, uint32_t now_ms, gh_measurement *temperature, gh_measurement *humidity)
{
    const gh_lines *lines = s->lines;
    if (s->state == GH_DHT22_IDLE) {
        if (now_ms - s->start_ms < PERIOD_MS || *s->listening) {
            return false;
        }
        s->start_ms = now_ms;
        if (!lines->is_high(lines->context, s->pin)) { /* stuck low: nobody could call */
            return fail(s, temperature, humidity);
        }
        *s->listening = true;
        lines->drive(lines->context, s->pin, GH_LEVEL_LOW);
        enter(s, GH_DHT22_CALLING);
    } else if (s->state == GH_DHT22_CALLING && has_waited(s, now_ms, CALL_MS)) {
        /* Listening before the release: an interrupt between the two cannot hide the first edges. */
        lines->listen(lines->context, s->pin);
        lines->drive(lines->context, s->pin, GH_LEVEL_RELEASED);
        enter(s, GH_DHT22_LISTENING);
    } else if (s->state == GH_DHT22_LISTENING && has_waited(s, now_ms, ANSWER_MS)) {
        *s->listening = false;
        enter(s, GH_DHT22_IDLE);
        return judge(s, temperature, humidity);
    }
    return false;
}
