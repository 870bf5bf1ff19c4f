#include "gh_safety.h"

#include <string.h>

#include "gh_frame.h"
#include "gh_messages.h"

#define PERSISTENT_LAYOUT 1u
#define ALL_LATCHES 15u
#define CLEARABLE (GH_LATCH(GH_TRIP_CAUSE_OVER_TEMPERATURE) | GH_LATCH(GH_TRIP_CAUSE_STORAGE_DAMAGED))

static bool lease_runs(const gh_lease *lease)
{
    return lease->length_ms > 0;
}

static void lease_advance(gh_lease *lease, uint32_t now_ms)
{
    if (now_ms - lease->start_ms >= lease->length_ms) { /* unsigned: right across the clock's wrap */
        lease->length_ms = 0;
    }
}

static uint16_t lease_left(const gh_lease *lease, uint32_t now_ms)
{
    return lease_runs(lease) ? (uint16_t)(lease->length_ms - (now_ms - lease->start_ms)) : 0;
}

static gh_lease lease_from(uint32_t now_ms, uint16_t length_ms, uint16_t longest_ms)
{
    gh_lease lease = {now_ms, length_ms < longest_ms ? length_ms : longest_ms};
    return lease;
}

static void end_heat_and_fan(gh_safety *safety)
{
    safety->heater.length_ms = 0;
    safety->fan.length_ms = 0;
}

static uint8_t latches_from(const uint8_t *persistent)
{
    static const uint8_t blank[GH_PERSISTENT_SIZE] = {0xFF, 0xFF, 0xFF, 0xFF};
    if (memcmp(persistent, blank, sizeof blank) == 0) {
        return 0;
    }
    if (persistent[0] != PERSISTENT_LAYOUT || persistent[1] > ALL_LATCHES ||
        gh_crc16(persistent, GH_PERSISTENT_SIZE) != 0) { /* a torn write: nobody knows, so do not heat */
        return GH_LATCH(GH_TRIP_CAUSE_STORAGE_DAMAGED);
    }
    return persistent[1];
}

void gh_safety_init(gh_safety *safety, const gh_safety_config *config, const uint8_t *persistent)
{
    memset(safety, 0, sizeof *safety);
    safety->config = *config;
    safety->latches = latches_from(persistent);
}

void gh_safety_persistent(const gh_safety *safety, uint8_t *out)
{
    out[0] = PERSISTENT_LAYOUT;
    out[1] = safety->latches;
    uint16_t crc = gh_crc16(out, 2);
    out[2] = (uint8_t)(crc >> 8);
    out[3] = (uint8_t)(crc & 0xFFu);
}

uint8_t gh_safety_trip_cause(const gh_safety *safety)
{
    static const uint8_t reported[] = {GH_TRIP_CAUSE_EMERGENCY_STOP, GH_TRIP_CAUSE_MAINTENANCE,
                                       GH_TRIP_CAUSE_STORAGE_DAMAGED, GH_TRIP_CAUSE_OVER_TEMPERATURE};
    for (uint8_t i = 0; i < sizeof reported; i++) {
        if (safety->latches & GH_LATCH(reported[i])) {
            return reported[i];
        }
    }
    return GH_TRIP_CAUSE_NONE;
}

static bool is_tripped(const gh_safety *safety)
{
    return safety->latches != 0;
}

/* Hands may be in the greenhouse: nothing is driven, the fan neither. */
static bool is_stopped(const gh_safety *safety)
{
    return (safety->latches & ~GH_LATCH(GH_TRIP_CAUSE_OVER_TEMPERATURE)) != 0;
}

/* Within a slot only a smaller duty is taken, so that the relay never chatters. */
static void take_smaller_duty(gh_safety *safety)
{
    uint8_t steps = gh_safety_heater_steps(safety);
    if (steps < safety->slot_steps) {
        safety->slot_steps = steps;
    }
}

static void advance_slot(gh_safety *safety, uint32_t now_ms)
{
    uint32_t elapsed = now_ms - safety->slot_start_ms;
    if (elapsed < safety->config.pwm_slot_ms) {
        return; /* most often: a 32-bit division takes an 8-bit board 600 cycles */
    }
    uint32_t passed = elapsed / safety->config.pwm_slot_ms;
    safety->slot_start_ms += passed * safety->config.pwm_slot_ms;
    safety->slot = (uint8_t)((safety->slot + passed) % GH_PWM_SLOTS);
    safety->slot_steps = gh_safety_heater_steps(safety);
}

void gh_safety_advance(gh_safety *safety, uint32_t now_ms)
{
    lease_advance(&safety->heater, now_ms);
    lease_advance(&safety->fan, now_ms);
    lease_advance(&safety->fan_time, now_ms);
    lease_advance(&safety->led, now_ms);
    lease_advance(&safety->valve, now_ms);
    lease_advance(&safety->valve_pulse, now_ms);
    if (!lease_runs(&safety->valve)) {
        safety->valve_pulse.length_ms = 0; /* or the next command would open the valve again */
    }
    if (safety->air_good && now_ms - safety->air_time_ms > GH_AIR_MAX_AGE_MS) {
        safety->air_good = false;
    }
    if (!safety->air_good) {
        end_heat_and_fan(safety);
    }
    advance_slot(safety, now_ms);
    take_smaller_duty(safety);
}

void gh_safety_greet(gh_safety *safety)
{
    safety->greeted = true;
}

static void count_hot_sample(gh_safety *safety)
{
    if (safety->air < safety->config.temp_trip) {
        safety->hot_samples = 0;
    } else if (safety->hot_samples < GH_TRIP_SAMPLES && ++safety->hot_samples == GH_TRIP_SAMPLES) {
        gh_safety_trip(safety, GH_TRIP_CAUSE_OVER_TEMPERATURE);
    }
}

void gh_safety_sample_air(gh_safety *safety, int16_t air, bool good, uint32_t now_ms)
{
    safety->air = air;
    safety->air_time_ms = now_ms;
    safety->air_good = good;
    if (good) {
        count_hot_sample(safety);
    } else {
        end_heat_and_fan(safety);
    }
    take_smaller_duty(safety);
}

bool gh_safety_obey(gh_safety *safety, const gh_demand *demand, uint32_t now_ms)
{
    const gh_safety_config *config = &safety->config;
    bool drives = demand->fan_on || demand->led_pct > 0 || demand->valve_pulse_ms > 0;
    if ((is_tripped(safety) && demand->heater_steps > 0) || (is_stopped(safety) && drives)) {
        return false;
    }
    gh_lease lease = lease_from(now_ms, demand->lease_ms, config->lease_max_ms);
    safety->demand = *demand;
    safety->led = lease;
    safety->valve = lease;
    if (safety->air_good && safety->greeted) {
        safety->heater = lease;
        safety->fan = lease;
        safety->fan_time = demand->fan_on_ms == 0 ? lease : lease_from(now_ms, demand->fan_on_ms, lease.length_ms);
    }
    if (demand->valve_pulse_ms > 0) {
        safety->valve_pulse = lease_from(now_ms, demand->valve_pulse_ms, config->valve_pulse_max_ms);
    }
    take_smaller_duty(safety);
    return true;
}

void gh_safety_trip(gh_safety *safety, uint8_t cause)
{
    safety->latches |= (uint8_t)GH_LATCH(cause);
    safety->led.length_ms = 0;
    safety->valve.length_ms = 0;
    safety->valve_pulse.length_ms = 0;
    end_heat_and_fan(safety);
    take_smaller_duty(safety);
}

bool gh_safety_clear_trip(gh_safety *safety)
{
    bool cool = safety->air_good && safety->air <= safety->config.temp_trip - GH_TRIP_HYSTERESIS;
    if ((safety->latches & CLEARABLE) != 0 && !cool) {
        return false;
    }
    safety->latches &= (uint8_t)~CLEARABLE;
    return true;
}

void gh_safety_release(gh_safety *safety, uint8_t cause)
{
    safety->latches &= (uint8_t)~GH_LATCH(cause);
}

static bool heat_allowed(const gh_safety *safety)
{
    return !is_tripped(safety) && safety->greeted && safety->air_good &&
           lease_runs(&safety->heater);
}

uint8_t gh_safety_heater_steps(const gh_safety *safety)
{
    return heat_allowed(safety) ? safety->demand.heater_steps : 0;
}

uint8_t gh_safety_heater_off_cause(const gh_safety *safety)
{
    if (gh_safety_heater_steps(safety) > 0) {
        return GH_HEATER_OFF_CAUSE_NONE;
    }
    if (is_tripped(safety)) {
        return GH_HEATER_OFF_CAUSE_TRIPPED;
    }
    if (!safety->greeted) {
        return GH_HEATER_OFF_CAUSE_NOT_GREETED;
    }
    if (!safety->air_good) {
        return GH_HEATER_OFF_CAUSE_SENSOR_FAULT;
    }
    return lease_runs(&safety->heater) ? GH_HEATER_OFF_CAUSE_COMMANDED : GH_HEATER_OFF_CAUSE_LEASE_EXPIRED;
}

/* The LED's lease is the longest: whatever ends it ends the others. */
uint16_t gh_safety_lease_left_ms(const gh_safety *safety, uint32_t now_ms)
{
    return lease_left(&safety->led, now_ms);
}

gh_pins gh_safety_pins(const gh_safety *safety)
{
    const gh_demand *demand = &safety->demand;
    bool tripped = is_tripped(safety);
    bool fan_asked = demand->fan_on && lease_runs(&safety->fan_time);
    bool fan = tripped || (lease_runs(&safety->fan) ? fan_asked : safety->config.fan_safe_on);
    gh_pins pins = {
        .heater_relay = safety->slot < safety->slot_steps,
        .fan = fan && !is_stopped(safety),
        .led_pct = lease_runs(&safety->led) ? demand->led_pct : 0,
        .valve = lease_runs(&safety->valve) && lease_runs(&safety->valve_pulse),
        .cutoff_open = safety->config.has_cutoff && (tripped || !lease_runs(&safety->heater) || demand->cutoff_open),
    };
    return pins;
}
