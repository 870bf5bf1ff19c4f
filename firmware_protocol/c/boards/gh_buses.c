#include "gh_buses.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>
#include <util/delay.h>

#define US_PER_TICK 4u /* of timer 1: 16 MHz / 64 */
#define TICKS(us) ((uint16_t)((us) / US_PER_TICK))

/* Timer 1 has one spare byte for all its 16-bit registers, and the interrupt of `lines` reads it too. */
static uint16_t ticks(void)
{
    uint16_t copy;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        copy = TCNT1;
    }
    return copy;
}

/* ---- I2C */

#if defined(__AVR_ATmega2560__)
#define SDA_PIN 20u
#define SCL_PIN 21u
#else
#define SDA_PIN 18u
#define SCL_PIN 19u
#endif
#define BIT_RATE 72u       /* 16 MHz / (16 + 2 * 72) = 100 kHz */
#define STRETCH_US 1100u   /* a byte and 1 ms of stretched clock */
#define TRANSFER_US 1900u  /* whatever happens */
#define HALF_CLOCK_US 5
#define STATUS_MASK 0xF8u
#define STARTED 0x08u
#define STARTED_AGAIN 0x10u
#define WRITING_HEARD 0x18u
#define BYTE_HEARD 0x28u
#define READING_HEARD 0x40u
#define BYTE_READ 0x50u
#define LAST_BYTE_READ 0x58u

/* Starts one action of the I2C unit and waits for its end; GH_BUS_SILENT where it ends as nobody wants. */
static gh_bus_result act(uint8_t bits, uint16_t begin, uint8_t wanted)
{
    uint16_t since = ticks();
    TWCR = (uint8_t)(_BV(TWINT) | _BV(TWEN) | bits);
    while ((TWCR & _BV(TWINT)) == 0) {
        uint16_t now = ticks();
        if ((uint16_t)(now - since) > TICKS(STRETCH_US) || (uint16_t)(now - begin) > TICKS(TRANSFER_US)) {
            return GH_BUS_SLOW;
        }
    }
    uint8_t status = TWSR & STATUS_MASK;
    return status == wanted || (wanted == STARTED && status == STARTED_AGAIN) ? GH_BUS_OK : GH_BUS_SILENT;
}

static gh_bus_result call(uint8_t address, bool reading, uint16_t begin)
{
    gh_bus_result result = act(_BV(TWSTA), begin, STARTED);
    if (result == GH_BUS_OK) {
        TWDR = (uint8_t)(address << 1 | (reading ? 1u : 0u));
        result = act(0, begin, reading ? READING_HEARD : WRITING_HEARD);
    }
    return result;
}

static gh_bus_result write_bytes(uint8_t address, const uint8_t *out, uint8_t size, uint16_t begin)
{
    gh_bus_result result = call(address, false, begin);
    for (uint8_t i = 0; i < size && result == GH_BUS_OK; i++) {
        TWDR = out[i];
        result = act(0, begin, BYTE_HEARD);
    }
    return result;
}

static gh_bus_result read_bytes(uint8_t address, uint8_t *in, uint8_t size, uint16_t begin)
{
    gh_bus_result result = call(address, true, begin);
    for (uint8_t i = 0; i < size && result == GH_BUS_OK; i++) {
        bool last = i + 1u == size; /* is not acknowledged: the part lets the bus go */
        result = act(last ? 0 : _BV(TWEA), begin, last ? LAST_BYTE_READ : BYTE_READ);
        in[i] = TWDR;
    }
    return result;
}

static bool bus_is_free(void)
{
    return gh_pin_is_high(gh_pin_at(SDA_PIN)) && gh_pin_is_high(gh_pin_at(SCL_PIN));
}

/* A part that lost count in the middle of a byte holds SDA low until it has got rid of the rest; then a stop. */
static void clock_out(void)
{
    gh_pin sda = gh_pin_at(SDA_PIN), scl = gh_pin_at(SCL_PIN);
    for (uint8_t i = 0; i < 9 && !gh_pin_is_high(sda); i++) {
        gh_pin_drive(scl, GH_LEVEL_LOW);
        _delay_us(HALF_CLOCK_US);
        gh_pin_drive(scl, GH_LEVEL_RELEASED);
        _delay_us(HALF_CLOCK_US);
    }
    gh_pin_drive(sda, GH_LEVEL_LOW);
    _delay_us(HALF_CLOCK_US);
    gh_pin_drive(sda, GH_LEVEL_RELEASED);
    _delay_us(HALF_CLOCK_US);
}

static gh_bus_result transfer(void *context, uint8_t address, const uint8_t *out, uint8_t out_size, uint8_t *in,
                              uint8_t in_size)
{
    (void)context;
    TWCR = 0; /* the pins are the port's */
    if (!bus_is_free()) {
        clock_out();
        if (!bus_is_free()) {
            return GH_BUS_STUCK;
        }
    }
    uint16_t begin = ticks();
    gh_bus_result result = GH_BUS_OK;
    if (out_size > 0 || in_size == 0) {
        result = write_bytes(address, out, out_size, begin);
    }
    if (result == GH_BUS_OK && in_size > 0) {
        result = read_bytes(address, in, in_size, begin);
    }
    if (result == GH_BUS_SLOW) {
        TWCR = 0; /* no stop: the clock is not ours */
        return gh_pin_is_high(gh_pin_at(SDA_PIN)) ? GH_BUS_SLOW : GH_BUS_STUCK;
    }
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    for (uint16_t since = ticks(); (TWCR & _BV(TWSTO)) != 0 && (uint16_t)(ticks() - since) < TICKS(100);) {
    }
    return result;
}

static void start_i2c(void)
{
    gh_pin_drive(gh_pin_at(SDA_PIN), GH_LEVEL_RELEASED); /* weak pull-ups beside those of the parts */
    gh_pin_drive(gh_pin_at(SCL_PIN), GH_LEVEL_RELEASED);
    TWBR = BIT_RATE;
    TWSR = 0;
}

/* ---- 1-Wire. An interrupt may lengthen a low level of 60 us to 80, not the 13 us until a bit is read. */

static gh_pin wire;

static gh_bus_result reset_wire(void *context)
{
    (void)context;
    if (!gh_pin_is_high(wire)) {
        return GH_BUS_STUCK;
    }
    gh_pin_drive(wire, GH_LEVEL_LOW);
    _delay_us(480);
    gh_pin_drive(wire, GH_LEVEL_RELEASED);
    uint16_t since = ticks();
    _delay_us(12); /* the pull-up needs a moment; presence comes after 15 us at the earliest */
    bool present = false;
    while ((uint16_t)(ticks() - since) < TICKS(480)) {
        present = present || !gh_pin_is_high(wire);
    }
    if (!gh_pin_is_high(wire)) {
        return GH_BUS_STUCK;
    }
    return present ? GH_BUS_OK : GH_BUS_SILENT;
}

static bool slot_of_wire(void *context, bool bit)
{
    (void)context;
    bool level = false;
    if (!bit) {
        gh_pin_drive(wire, GH_LEVEL_LOW);
        _delay_us(60);
        gh_pin_drive(wire, GH_LEVEL_RELEASED);
    } else {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            gh_pin_drive(wire, GH_LEVEL_LOW);
            _delay_us(2);
            gh_pin_drive(wire, GH_LEVEL_RELEASED);
            _delay_us(8);
            level = gh_pin_is_high(wire);
        }
        _delay_us(50);
    }
    _delay_us(5); /* between two slots */
    return level;
}

/* ---- single pins */

#define HIGHS_MAX 43u /* of a DHT22: its call, its greeting, 40 bits and one to spare */
#define ADC_TURNS_MAX 200u /* a conversion takes 104 us */

static struct {
    gh_pin pin;
    uint16_t high_us[HIGHS_MAX];
    uint16_t began;
    uint8_t count;
    bool is_high; /* since `began` */
} listened;

static void on_change(void)
{
    uint16_t now = TCNT1;
    if (gh_pin_is_high(listened.pin)) {
        listened.began = now;
        listened.is_high = true;
        return;
    }
    if (!listened.is_high) {
        return;
    }
    listened.is_high = false;
    uint16_t length = now - listened.began;
    if (listened.count < HIGHS_MAX) {
        listened.high_us[listened.count] = length > TICKS(GH_PULSE_MAX_US) ? GH_PULSE_MAX_US : length * US_PER_TICK;
    }
    listened.count = listened.count < 255u ? listened.count + 1u : 255u;
}

ISR(PCINT0_vect)
{
    on_change();
}

ISR(PCINT2_vect, ISR_ALIASOF(PCINT0_vect));
#if !defined(__AVR_ATmega2560__)
ISR(PCINT1_vect, ISR_ALIASOF(PCINT0_vect));
#endif

static void drive(void *context, uint8_t pin, gh_level level)
{
    (void)context;
    gh_pin_drive(gh_pin_at(pin), level);
}

static bool is_high(void *context, uint8_t pin)
{
    (void)context;
    return gh_pin_is_high(gh_pin_at(pin));
}

static void pulse(void *context, uint8_t pin, uint8_t high_us)
{
    (void)context;
    gh_pin output = gh_pin_at(pin);
    gh_pin_drive(output, GH_LEVEL_HIGH);
    while (high_us-- > 0) {
        _delay_us(1);
    }
    gh_pin_drive(output, GH_LEVEL_LOW);
}

static void listen(void *context, uint8_t pin)
{
    (void)context;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        listened.pin = gh_pin_at(pin);
        listened.count = 0;
        listened.is_high = false; /* a level of before is not timed */
        gh_pin_listen(listened.pin);
    }
}

static uint8_t heard(void *context, uint16_t *high_us, uint8_t size)
{
    (void)context;
    uint8_t count = listened.count;
    for (uint8_t i = 0; i < count && i < size && i < HIGHS_MAX; i++) {
        high_us[i] = listened.high_us[i]; /* has ended, so no interrupt changes it */
    }
    return count;
}

static uint16_t analog(void *context, uint8_t pin)
{
    (void)context;
    uint8_t channel = (uint8_t)(pin - GH_FIRST_ANALOG);
    ADMUX = (uint8_t)(_BV(REFS0) | (channel & 7u)); /* of the supply */
#if defined(__AVR_ATmega2560__)
    ADCSRB = channel > 7u ? _BV(MUX5) : 0;
#endif
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    for (uint8_t turns = 0; (ADCSRA & _BV(ADSC)) != 0 && turns < ADC_TURNS_MAX; turns++) {
        _delay_us(2);
    }
    return ADC;
}

void gh_buses_start(gh_buses *buses, uint8_t wire_pin)
{
    TCCR1A = 0;
    TCCR1B = _BV(CS11) | _BV(CS10);
    start_i2c();
    if (wire_pin != GH_NO_PIN) {
        wire = gh_pin_at(wire_pin);
        gh_pin_drive(wire, GH_LEVEL_RELEASED);
    }
    *buses = (gh_buses){
        .i2c = {NULL, transfer},
        .wire = {NULL, reset_wire, slot_of_wire},
        .lines = {NULL, drive, is_high, pulse, listen, heard, analog},
    };
}
