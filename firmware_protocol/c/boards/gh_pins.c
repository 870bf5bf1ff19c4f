#include "gh_pins.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>

/* A port's three registers follow one another; from H on they lie in the extended space. */
#define PORT_PIN(port, bit) (uint8_t)(((port) - 'A') << 3 | (bit))

#if defined(__AVR_ATmega2560__)
static const uint8_t PINS[] PROGMEM = {
    PORT_PIN('E', 0), PORT_PIN('E', 1), PORT_PIN('E', 4), PORT_PIN('E', 5), PORT_PIN('G', 5), /* 0 */
    PORT_PIN('E', 3), PORT_PIN('H', 3), PORT_PIN('H', 4), PORT_PIN('H', 5), PORT_PIN('H', 6), /* 5 */
    PORT_PIN('B', 4), PORT_PIN('B', 5), PORT_PIN('B', 6), PORT_PIN('B', 7), PORT_PIN('J', 1), /* 10 */
    PORT_PIN('J', 0), PORT_PIN('H', 1), PORT_PIN('H', 0), PORT_PIN('D', 3), PORT_PIN('D', 2), /* 15 */
    PORT_PIN('D', 1), PORT_PIN('D', 0), PORT_PIN('A', 0), PORT_PIN('A', 1), PORT_PIN('A', 2), /* 20 */
    PORT_PIN('A', 3), PORT_PIN('A', 4), PORT_PIN('A', 5), PORT_PIN('A', 6), PORT_PIN('A', 7), /* 25 */
    PORT_PIN('C', 7), PORT_PIN('C', 6), PORT_PIN('C', 5), PORT_PIN('C', 4), PORT_PIN('C', 3), /* 30 */
    PORT_PIN('C', 2), PORT_PIN('C', 1), PORT_PIN('C', 0), PORT_PIN('D', 7), PORT_PIN('G', 2), /* 35 */
    PORT_PIN('G', 1), PORT_PIN('G', 0), PORT_PIN('L', 7), PORT_PIN('L', 6), PORT_PIN('L', 5), /* 40 */
    PORT_PIN('L', 4), PORT_PIN('L', 3), PORT_PIN('L', 2), PORT_PIN('L', 1), PORT_PIN('L', 0), /* 45 */
    PORT_PIN('B', 3), PORT_PIN('B', 2), PORT_PIN('B', 1), PORT_PIN('B', 0), PORT_PIN('F', 0), /* 50 */
    PORT_PIN('F', 1), PORT_PIN('F', 2), PORT_PIN('F', 3), PORT_PIN('F', 4), PORT_PIN('F', 5), /* 55 */
    PORT_PIN('F', 6), PORT_PIN('F', 7), PORT_PIN('K', 0), PORT_PIN('K', 1), PORT_PIN('K', 2), /* 60 */
    PORT_PIN('K', 3), PORT_PIN('K', 4), PORT_PIN('K', 5), PORT_PIN('K', 6), PORT_PIN('K', 7), /* 65 */
};
#else
static const uint8_t PINS[] PROGMEM = {
    PORT_PIN('D', 0), PORT_PIN('D', 1), PORT_PIN('D', 2), PORT_PIN('D', 3), PORT_PIN('D', 4), /* 0 */
    PORT_PIN('D', 5), PORT_PIN('D', 6), PORT_PIN('D', 7), PORT_PIN('B', 0), PORT_PIN('B', 1), /* 5 */
    PORT_PIN('B', 2), PORT_PIN('B', 3), PORT_PIN('B', 4), PORT_PIN('B', 5), PORT_PIN('C', 0), /* 10 */
    PORT_PIN('C', 1), PORT_PIN('C', 2), PORT_PIN('C', 3), PORT_PIN('C', 4), PORT_PIN('C', 5), /* 15 */
};
#endif

#define DIRECTION 1
#define OUTPUT 2
#define GROUPS 3u

static volatile uint8_t *first_register(uint8_t port)
{
#if defined(__AVR_ATmega2560__)
    if (port > 'G' - 'A') {
        uint8_t from_h = port - ('H' - 'A');
        return &PINH + 3u * (from_h > 0 ? from_h - 1u : 0u); /* there is no port I */
    }
    return &PINA + 3u * port;
#else
    return &PINB + 3u * (port - 1u);
#endif
}

gh_pin gh_pin_at(uint8_t number)
{
    uint8_t place = pgm_read_byte(&PINS[number]);
    return (gh_pin){first_register(place >> 3), (uint8_t)(1u << (place & 7u))};
}

void gh_pin_drive(gh_pin pin, gh_level level)
{
    /* A pin that becomes an output has its level first; one that is let go is no output first. */
    if (level == GH_LEVEL_RELEASED) {
        pin.in[DIRECTION] &= (uint8_t)~pin.mask;
    }
    if (level == GH_LEVEL_LOW) {
        pin.in[OUTPUT] &= (uint8_t)~pin.mask;
    } else {
        pin.in[OUTPUT] |= pin.mask;
    }
    if (level != GH_LEVEL_RELEASED) {
        pin.in[DIRECTION] |= pin.mask;
    }
}

/* Interrupts on a change come from groups of eight pins. */
static uint8_t change_group(gh_pin pin)
{
#if defined(__AVR_ATmega2560__)
    return pin.in == &PINB ? 0u : 2u; /* of group 1, E0 and port J, no pin is offered */
#else
    return pin.in == &PINB ? 0u : pin.in == &PINC ? 1u : 2u;
#endif
}

void gh_pin_listen(gh_pin pin)
{
    uint8_t group = change_group(pin);
    PCICR = 0;
    for (uint8_t i = 0; i < GROUPS; i++) {
        (&PCMSK0)[i] = i == group ? pin.mask : 0;
    }
    PCIFR = (uint8_t)(1u << group); /* a change of before is none of this pin's */
    PCICR = (uint8_t)(1u << group);
}

/* Fast PWM with 8 bits, 977 Hz. */
#if defined(__AVR_ATmega2560__)
#define LED_CONTROL TCCR4A
#define LED_MODE _BV(WGM40)

static void start_timer(void)
{
    LED_CONTROL = LED_MODE;
    TCCR4B = _BV(WGM42) | _BV(CS41) | _BV(CS40);
}

/* Bits that connect the timer, non-inverting; the bit below inverts. */
static uint8_t connection(uint8_t number, uint8_t compare)
{
    switch (number) {
    case 6:
        OCR4A = compare;
        return _BV(COM4A1);
    case 7:
        OCR4B = compare;
        return _BV(COM4B1);
    default:
        OCR4C = compare;
        return _BV(COM4C1);
    }
}
#else
#define LED_CONTROL TCCR2A
#define LED_MODE (_BV(WGM21) | _BV(WGM20))

static void start_timer(void)
{
    LED_CONTROL = LED_MODE;
    TCCR2B = _BV(CS22);
}

static uint8_t connection(uint8_t number, uint8_t compare)
{
    if (number == 3) {
        OCR2B = compare;
        return _BV(COM2B1);
    }
    OCR2A = compare;
    return _BV(COM2A1);
}
#endif

void gh_led_start(uint8_t number)
{
    if (number != GH_NO_PIN) {
        start_timer();
    }
}

/* 0 % disconnects the timer: fast PWM at 0 would still glow. */
void gh_led_drive(uint8_t number, uint8_t pct, bool inverted)
{
    if (number == GH_NO_PIN) {
        return;
    }
    if (pct == 0) {
        LED_CONTROL = LED_MODE;
        return;
    }
    uint8_t bits = connection(number, (uint8_t)(pct * 255u / 100u));
    LED_CONTROL = (uint8_t)(LED_MODE | bits | (inverted ? bits >> 1 : 0));
}
