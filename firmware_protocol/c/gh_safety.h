/* The board's own safety: what may be driven now, whatever the host says. See PROTOCOL.md, "The board".
 * Time is passed in [ms], wraps, never goes back. Temperatures are in 0.01 degC. */
#ifndef GH_SAFETY_H
#define GH_SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#define GH_PERSISTENT_SIZE 4u
#define GH_AIR_MAX_AGE_MS 3000u
#define GH_AIR_MIN (-2000)          /* 0.01 degC: outside, the sensor is at fault */
#define GH_AIR_MAX 8000
#define GH_TRIP_HYSTERESIS 300      /* 0.01 K */
#define GH_TRIP_SAMPLES 2u
#define GH_PWM_SLOTS 20u
#define GH_LATCH(cause) (1u << ((cause) - 1u))

typedef struct {
    uint16_t lease_max_ms;
    uint16_t valve_pulse_max_ms;
    uint16_t pwm_slot_ms;
    int16_t temp_trip; /* 0.01 degC */
    bool fan_safe_on;
    bool has_cutoff;
} gh_safety_config;

/* Permission that ends by itself: running from `start_ms` for less than `length_ms`. */
typedef struct {
    uint32_t start_ms;
    uint16_t length_ms; /* 0: not running */
} gh_lease;

typedef struct {
    uint8_t heater_steps; /* duty in 1/20 */
    uint8_t led_pct;
    bool fan_on;
    uint16_t fan_on_ms; /* 0: until the lease ends */
    bool cutoff_open;
    uint16_t valve_pulse_ms; /* 0: no new pulse */
    uint16_t lease_ms;
} gh_demand;

typedef struct {
    bool heater_relay;
    bool fan;
    uint8_t led_pct;
    bool valve;
    bool cutoff_open;
} gh_pins;

typedef struct {
    gh_safety_config config;
    gh_demand demand; /* the last one obeyed; each part holds while its lease runs */
    gh_lease heater, fan, fan_time, led, valve, valve_pulse; /* fan_time: the part of `fan` in which it turns */
    uint32_t slot_start_ms;
    uint8_t slot;         /* 0..19 in the PWM window */
    uint8_t slot_steps;   /* duty taken for this slot */
    uint32_t air_time_ms;
    int16_t air;          /* 0.01 degC, when air_good */
    bool air_good;
    uint8_t hot_samples;
    uint8_t latches; /* a bit for each trip cause: GH_LATCH */
    bool greeted;
} gh_safety;

/* All outputs safe. `persistent` is what gh_safety_persistent gave before the reset, or blank (all 0xFF). */
void gh_safety_init(gh_safety *safety, const gh_safety_config *config, const uint8_t *persistent);
void gh_safety_persistent(const gh_safety *safety, uint8_t *out);

/* Ends what has run out. Call it first at every entry, at least every 100 ms. */
void gh_safety_advance(gh_safety *safety, uint32_t now_ms);

void gh_safety_greet(gh_safety *safety);
/* A new air sample [0.01 degC]; `good` false when there is no number to trust. */
void gh_safety_sample_air(gh_safety *safety, int16_t air, bool good, uint32_t now_ms);
/* Takes a command's outputs. Returns false, and takes nothing, for heat while tripped and for anything while
 * stopped. */
bool gh_safety_obey(gh_safety *safety, const gh_demand *demand, uint32_t now_ms);
void gh_safety_trip(gh_safety *safety, uint8_t cause);
/* Clears over-temperature and storage damage, never a stop. Returns false, and changes nothing, while the air is too
 * warm or not known. */
bool gh_safety_clear_trip(gh_safety *safety);
/* Ends a stop or a maintenance; every other latch stays. */
void gh_safety_release(gh_safety *safety, uint8_t cause);

/* The cause to report of all that is latched: a stop hides an over-temperature. */
uint8_t gh_safety_trip_cause(const gh_safety *safety);

uint8_t gh_safety_heater_steps(const gh_safety *safety);
uint8_t gh_safety_heater_off_cause(const gh_safety *safety);
uint16_t gh_safety_lease_left_ms(const gh_safety *safety, uint32_t now_ms);
gh_pins gh_safety_pins(const gh_safety *safety);

#endif
