/* Stands in for all sensors of drivers/gh_sensors.c: a test writes these variables into the simulated memory. Not cleared by a reset. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "gh_sensors.h"

#define PERIOD_MS 1000u

enum { WORKS, HANGS, KEEPS_INTERRUPTS_OFF, STOPS_THE_CLOCK, TELLS_NOTHING };

volatile int32_t rig_air __attribute__((section(".noinit")));      /* 0.01 degC or GH_NO_VALUE */
volatile uint8_t rig_quality __attribute__((section(".noinit")));  /* GH_QUALITY_... */
volatile uint8_t rig_fault __attribute__((section(".noinit")));

void gh_sensors_init(gh_sensors *s, const gh_config *config, const gh_buses *buses, uint32_t now_ms)
{
    (void)config, (void)buses;
    s->co2_told_ms = now_ms;
}

uint16_t gh_config_capabilities(const gh_config *config)
{
    (void)config;
    return GH_CAPABILITY_LED | GH_CAPABILITY_VALVE | GH_CAPABILITY_HEATER_CUTOFF;
}

void gh_sensors_step(gh_sensors *s, gh_board *board, uint32_t now_ms)
{
    if (now_ms - s->co2_told_ms < PERIOD_MS) {
        return;
    }
    s->co2_told_ms = now_ms;
    while (rig_fault == HANGS) {
    }
    if (rig_fault == KEEPS_INTERRUPTS_OFF) {
        cli();
    }
    if (rig_fault == STOPS_THE_CLOCK) {
        TIMSK0 = 0;
    }
    if (rig_fault != TELLS_NOTHING) {
        gh_board_sample(board, GH_SIGNAL_TEMP_AIR, rig_air, rig_quality, now_ms);
    }
}
