/* Stands in for the sensors of a rig: a test writes these variables into the simulated memory. Not cleared by a reset. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "gh_board.h"

enum { WORKS, HANGS, KEEPS_INTERRUPTS_OFF, STOPS_THE_CLOCK, TELLS_NOTHING };

volatile int32_t rig_air __attribute__((section(".noinit")));      /* 0.01 degC or GH_NO_VALUE */
volatile uint8_t rig_quality __attribute__((section(".noinit")));  /* GH_QUALITY_... */
volatile uint8_t rig_fault __attribute__((section(".noinit")));

void gh_read_sensors(gh_board *board, uint32_t now_ms)
{
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
