/* The board on an ATmega2560 at 16 MHz (Arduino Mega 2560): an example to start a rig from. See ../README.md.
 *
 *   PA0 heater relay   PA1 fan relay   PA2 valve   PA3 closes the cut-off relay in the heater's supply
 *   PH3 (OC4A) LED PWM   UART0 115200 8N1 to the host
 *
 * Relay inputs need pull-downs: while the pins float in a reset the heater is off and its supply open.
 */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <string.h>
#include <util/atomic.h>

#include "gh_board.h"

#define HEATER_PIN _BV(PA0)
#define FAN_PIN _BV(PA1)
#define VALVE_PIN _BV(PA2)
#define SUPPLY_PIN _BV(PA3)
#define OUTPUT_PINS (HEATER_PIN | FAN_PIN | VALVE_PIN | SUPPLY_PIN)

#define UART_DIVISOR 16u        /* 16 MHz / (8 * 17) = 117647 baud, 2.1 % fast */
#define TICKS_PER_MS 250u       /* 16 MHz / 64 */
#define RECEIVE_SIZE 256u       /* 22 ms of line; storing a trip takes 14; the index wraps as uint8_t */
#define SAMPLE_PERIOD_MS 1000u

static const gh_board_config CONFIG = {
    .board_id = 1,
    .firmware_major = 1,
    .capabilities = GH_CAPABILITY_LED | GH_CAPABILITY_VALVE | GH_CAPABILITY_HEATER_CUTOFF,
    .lease_max_ms = 10000,
    .temp_trip = 4500,
    .valve_pulse_max_ds = 50,
    .pwm_window_ds = 200,
    .report_period_ms = 1000,
    .fan_safe_on = true,
};

/* Blank, so that whoever writes the program's EEPROM section too stores no trip with it. */
static uint8_t EEMEM stored_trip[GH_PERSISTENT_SIZE] = {0xFF, 0xFF, 0xFF, 0xFF};
static uint32_t EEMEM stored_boots = UINT32_MAX;

static volatile uint32_t milliseconds;
static volatile uint8_t received[RECEIVE_SIZE];
static volatile uint8_t received_head;
static uint8_t received_tail;

/* Survives the clearing of .bss: MCUSR has to be read, and the watchdog stopped, before main. A bootloader may have
 * cleared MCUSR; then the cause is unknown. */
static uint8_t reset_flags __attribute__((section(".noinit")));

void keep_reset_flags(void) __attribute__((naked, used, section(".init3")));
void keep_reset_flags(void)
{
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

/* The rig's sensors: replace this function. Call gh_board_sample for each signal once a second, GH_NO_VALUE and
 * GH_QUALITY_FAULT for a sensor that does not answer. Never wait longer than 20 ms, nor keep interrupts off longer than
 * 0.1 ms: the line loses bytes after 0.17 ms, and after 1 ms the clock that ends the leases loses time. As it stands
 * there is no air temperature, so the heater stays off. */
__attribute__((weak)) void gh_read_sensors(gh_board *board, uint32_t now_ms)
{
    gh_board_sample(board, GH_SIGNAL_TEMP_AIR, GH_NO_VALUE, GH_QUALITY_ABSENT, now_ms);
}

ISR(TIMER0_COMPA_vect)
{
    milliseconds++;
}

ISR(USART0_RX_vect)
{
    received[received_head++] = UDR0; /* a lap too far damages frames, and their CRC tells */
}

static uint32_t now(void)
{
    uint32_t copy;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        copy = milliseconds;
    }
    return copy;
}

/* When the power comes the brown-out detector may have seen it too low on its way up. */
static uint8_t reset_cause(void)
{
    if (reset_flags & _BV(PORF)) {
        return GH_RESET_CAUSE_POWER_ON;
    }
    if (reset_flags & _BV(BORF)) {
        return GH_RESET_CAUSE_BROWN_OUT;
    }
    if (reset_flags & _BV(WDRF)) {
        return GH_RESET_CAUSE_WATCHDOG;
    }
    return reset_flags & _BV(EXTRF) ? GH_RESET_CAUSE_EXTERNAL : GH_RESET_CAUSE_UNKNOWN;
}

static void start_outputs(void)
{
    PORTA = 0; /* before the pins become outputs; the fan too, until the store has said that nobody stopped it */
    DDRA = OUTPUT_PINS;
    DDRH |= _BV(PH3);
    TCCR4A = _BV(WGM40); /* fast PWM, 8 bit, 977 Hz */
    TCCR4B = _BV(WGM42) | _BV(CS41) | _BV(CS40);
}

static void start_clock(void)
{
    TCCR0A = _BV(WGM01); /* clear on compare match */
    OCR0A = TICKS_PER_MS - 1;
    TIMSK0 = _BV(OCIE0A);
    TCCR0B = _BV(CS01) | _BV(CS00);
}

static void start_uart(void)
{
    UBRR0 = UART_DIVISOR;
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

/* 0 % disconnects the timer: fast PWM at 0 would still glow. */
static void drive_led(uint8_t pct)
{
    OCR4A = (uint16_t)(pct * 255u / 100u);
    TCCR4A = pct > 0 ? _BV(WGM40) | _BV(COM4A1) : _BV(WGM40);
}

static void drive(const gh_pins *pins)
{
    uint8_t port = 0;
    port |= pins->heater_relay ? HEATER_PIN : 0;
    port |= pins->fan ? FAN_PIN : 0;
    port |= pins->valve ? VALVE_PIN : 0;
    port |= pins->cutoff_open ? 0 : SUPPLY_PIN;
    PORTA = port;
    drive_led(pins->led_pct);
}

/* The pins stand before the write begins: it takes 3.4 ms a byte. */
static void store_trip(const gh_board *board)
{
    uint8_t wanted[GH_PERSISTENT_SIZE];
    gh_board_persistent(board, wanted);
    eeprom_update_block(wanted, stored_trip, sizeof wanted);
}

static uint32_t count_boot(void)
{
    uint32_t boots = eeprom_read_dword(&stored_boots) + 1; /* a blank cell is 0xFFFFFFFF: the first start is 0 */
    eeprom_update_dword(&stored_boots, boots);
    return boots;
}

static void exchange_bytes(gh_board *board)
{
    uint8_t head = received_head; /* what comes meanwhile waits for the next round, or step would starve */
    while (received_tail != head) {
        gh_board_receive(board, received[received_tail++], now());
    }
    uint8_t byte;
    if ((UCSR0A & _BV(UDRE0)) && gh_board_transmit(board, &byte, 1) == 1) {
        UDR0 = byte;
    }
}

int main(void)
{
    static gh_board board;
    uint8_t persistent[GH_PERSISTENT_SIZE];
    uint32_t sampled_ms = 0, fed_ms = 0;

    start_outputs();
    wdt_enable(WDTO_250MS);
    eeprom_read_block(persistent, stored_trip, sizeof persistent);
    gh_board_init(&board, &CONFIG, persistent, reset_cause(), count_boot());
    gh_pins pins = gh_board_step(&board, 0);
    drive(&pins);
    start_clock();
    start_uart();
    sei();
    for (;;) {
        exchange_bytes(&board);
        uint32_t now_ms = now();
        if (now_ms != fed_ms) { /* a loop that hangs or a clock that stands, which no lease would end by, resets */
            fed_ms = now_ms;
            wdt_reset(); /* here only */
        }
        if (now_ms - sampled_ms >= SAMPLE_PERIOD_MS) {
            sampled_ms = now_ms;
            gh_read_sensors(&board, now_ms);
        }
        pins = gh_board_step(&board, now_ms);
        drive(&pins);
        store_trip(&board);
    }
}
