#include "gh_avr_pins.h"

#include <avr/io.h>
#include <avr/pgmspace.h>

typedef struct {
    uint16_t port; /* address */
    uint8_t bit;
} pin_row;

/* Rows from the pin mapping tables at docs.arduino.cc ("ATmega2560-Arduino Pin Mapping", "ATmega168/328P-Arduino Pin
 * Mapping"). Constant addresses, so that the table is data of the flash. */
#if defined(__AVR_ATmega2560__)
#define P(letter, bit) {(uint16_t)PORT_##letter, bit}
enum {
    PORT_A = 0x22, PORT_B = 0x25, PORT_C = 0x28, PORT_D = 0x2B, PORT_E = 0x2E, PORT_F = 0x31, PORT_G = 0x34,
    PORT_H = 0x102, PORT_J = 0x105, PORT_K = 0x108, PORT_L = 0x10B
};
static const pin_row PINS[] PROGMEM = {
    P(E, 0), P(E, 1), P(E, 4), P(E, 5), P(G, 5), P(E, 3), P(H, 3), P(H, 4), P(H, 5), P(H, 6), P(B, 4), P(B, 5),
    P(B, 6), P(B, 7), P(J, 1), P(J, 0), P(H, 1), P(H, 0), P(D, 3), P(D, 2), P(D, 1), P(D, 0), P(A, 0), P(A, 1),
    P(A, 2), P(A, 3), P(A, 4), P(A, 5), P(A, 6), P(A, 7), P(C, 7), P(C, 6), P(C, 5), P(C, 4), P(C, 3), P(C, 2),
    P(C, 1), P(C, 0), P(D, 7), P(G, 2), P(G, 1), P(G, 0), P(L, 7), P(L, 6), P(L, 5), P(L, 4), P(L, 3), P(L, 2),
    P(L, 1), P(L, 0), P(B, 3), P(B, 2), P(B, 1), P(B, 0), P(F, 0), P(F, 1), P(F, 2), P(F, 3), P(F, 4), P(F, 5),
    P(F, 6), P(F, 7), P(K, 0), P(K, 1), P(K, 2), P(K, 3), P(K, 4), P(K, 5), P(K, 6), P(K, 7),
};
#define FIRST_ANALOG 54u
#define CHANGE_GROUP_0 PORT_B
#define CHANGE_GROUP_2 PORT_K
#else
#define P(letter, bit) {(uint16_t)PORT_##letter, bit}
enum { PORT_B = 0x25, PORT_C = 0x28, PORT_D = 0x2B };
static const pin_row PINS[] PROGMEM = {
    P(D, 0), P(D, 1), P(D, 2), P(D, 3), P(D, 4), P(D, 5), P(D, 6), P(D, 7), P(B, 0), P(B, 1),
    P(B, 2), P(B, 3), P(B, 4), P(B, 5), P(C, 0), P(C, 1), P(C, 2), P(C, 3), P(C, 4), P(C, 5),
};
#define FIRST_ANALOG 14u
#define CHANGE_GROUP_0 PORT_B
#define CHANGE_GROUP_1 PORT_C
#define CHANGE_GROUP_2 PORT_D
#endif

gh_pin gh_pin_of(uint8_t number)
{
    uint16_t port = pgm_read_word(&PINS[number].port);
    return (gh_pin){(volatile uint8_t *)(uintptr_t)port, (uint8_t)(1u << pgm_read_byte(&PINS[number].bit))};
}

/* Ports beyond the first 32 addresses are changed by several instructions: an interrupt between them changes none of
 * them, because no interrupt writes a port. */
void gh_pin_drive(uint8_t number, gh_level level)
{
    gh_pin pin = gh_pin_of(number);
    volatile uint8_t *direction = pin.port - 1;
    if (level == GH_LEVEL_RELEASED) {
        *direction &= (uint8_t)~pin.mask;
        *pin.port |= pin.mask; /* the pull-up */
        return;
    }
    if (level == GH_LEVEL_HIGH) {
        *pin.port |= pin.mask;
    } else {
        *pin.port &= (uint8_t)~pin.mask;
    }
    *direction |= pin.mask;
}

bool gh_pin_is_high(uint8_t number)
{
    gh_pin pin = gh_pin_of(number);
    return (*(pin.port - 2) & pin.mask) != 0;
}

bool gh_pin_watch(uint8_t number)
{
    gh_pin pin = gh_pin_of(number);
    gh_pin_unwatch();
    switch ((uint16_t)(uintptr_t)pin.port) {
    case CHANGE_GROUP_0:
        PCMSK0 = pin.mask;
        PCICR = _BV(PCIE0);
        return true;
#ifdef CHANGE_GROUP_1
    case CHANGE_GROUP_1:
        PCMSK1 = pin.mask;
        PCICR = _BV(PCIE1);
        return true;
#endif
    case CHANGE_GROUP_2:
        PCMSK2 = pin.mask;
        PCICR = _BV(PCIE2);
        return true;
    default:
        return false;
    }
}

void gh_pin_unwatch(void)
{
    PCICR = 0;
    PCMSK0 = PCMSK1 = PCMSK2 = 0;
    PCIFR = _BV(PCIF0) | _BV(PCIF1) | _BV(PCIF2); /* what is pending is of the pin before */
}

uint8_t gh_pin_channel(uint8_t number)
{
    return (uint8_t)(number - FIRST_ANALOG);
}

#if defined(__AVR_ATmega2560__)
void gh_pin_pwm(uint8_t number, uint8_t pct)
{
    uint16_t level = (uint16_t)(pct * 255u / 100u);
    uint8_t output = number == 6 ? _BV(COM4A1) : number == 7 ? _BV(COM4B1) : _BV(COM4C1);
    OCR4A = OCR4B = OCR4C = level;
    TCCR4B = _BV(WGM42) | _BV(CS41) | _BV(CS40); /* fast PWM, 8 bit, 977 Hz */
    TCCR4A = pct > 0 ? (uint8_t)(_BV(WGM40) | output) : _BV(WGM40);
}
#else
void gh_pin_pwm(uint8_t number, uint8_t pct)
{
    uint8_t output = number == 11 ? _BV(COM2A1) : _BV(COM2B1);
    OCR2A = OCR2B = (uint8_t)(pct * 255u / 100u);
    TCCR2B = _BV(CS22); /* fast PWM, 8 bit, 977 Hz */
    TCCR2A = pct > 0 ? (uint8_t)(_BV(WGM21) | _BV(WGM20) | output) : (uint8_t)(_BV(WGM21) | _BV(WGM20));
}
#endif
