/* The pins of an Arduino by the numbers that are printed on it. */
#ifndef GH_AVR_PINS_H
#define GH_AVR_PINS_H

#include <stdbool.h>
#include <stdint.h>

#include "gh_bus.h"

/* `mask` of `*port` is the pin; its direction stands one address before, its input two. */
typedef struct {
    volatile uint8_t *port;
    uint8_t mask;
} gh_pin;

gh_pin gh_pin_of(uint8_t number);

void gh_pin_drive(uint8_t number, gh_level level);
bool gh_pin_is_high(uint8_t number);

/* The interrupt on a change of this pin alone, in its group of eight; false where the pin has none. */
bool gh_pin_watch(uint8_t number);
void gh_pin_unwatch(void);

/* The analog channel of a pin, whose number the caller has checked. */
uint8_t gh_pin_channel(uint8_t number);

/* The LED's PWM [%] on its pin; 0 % disconnects the timer: fast PWM at 0 would still glow. */
void gh_pin_pwm(uint8_t number, uint8_t pct);

#endif
