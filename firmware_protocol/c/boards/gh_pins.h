/* Pins of the Arduino Mega (ATmega2560) and Uno or Nano (ATmega328P) by the numbers that are printed beside them. */
#ifndef GH_PINS_H
#define GH_PINS_H

#include <stdint.h>

#include "gh_bus.h"
#include "gh_config.h"

#if defined(__AVR_ATmega2560__)
#define GH_KIND GH_MEGA2560
#define GH_FIRST_ANALOG 54u
#elif defined(__AVR_ATmega328P__)
#define GH_KIND GH_UNO
#define GH_FIRST_ANALOG 14u
#else
#error "there is no table of pins for this microcontroller"
#endif

/* Registers of a pin: `in`, then its direction, then its output. */
typedef struct {
    volatile uint8_t *in;
    uint8_t mask;
} gh_pin;

/* `number` is one that gh_config_read has admitted. */
gh_pin gh_pin_at(uint8_t number);

void gh_pin_drive(gh_pin pin, gh_level level);

static inline bool gh_pin_is_high(gh_pin pin)
{
    return (*pin.in & pin.mask) != 0;
}

/* From now on an interrupt comes at each change of this pin, and of no other. */
void gh_pin_listen(gh_pin pin);

/* Brightness of the LED at `number`, one of the pins that have a timer, 0..100 %; of a lamp that is on while its pin
 * is low the same. */
void gh_led_start(uint8_t number);
void gh_led_drive(uint8_t number, uint8_t pct, bool inverted);

#endif
