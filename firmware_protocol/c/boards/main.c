/* The program of a board: pins, parts and limits from its EEPROM, UART0 at 115200 8N1 to the host. Without a
 * configuration it drives no pin and reads no sensor.
 *
 * Relay inputs need pull resistors to the level at which they are off: while the pins float in a reset nothing else
 * keeps the heater off.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "gh_buses.h"
#include "gh_eeprom.h"
#include "gh_one_wire.h"
#include "gh_pins.h"
#include "gh_sensors.h"

#define FIRMWARE_MAJOR 1u
#define FIRMWARE_MINOR 2u
#define FIRMWARE_PATCH 0u
#define UART_DIVISOR 16u /* 16 MHz / (8 * 17) = 117647 baud, 2.1 % fast */
#define TICKS_PER_MS 250u /* 16 MHz / 64 */
#if defined(__AVR_ATmega2560__)
#define RECEIVE_SIZE 256u /* 22 ms of line; storing a trip takes 14 */
#define RECEIVED_VECTOR USART0_RX_vect
#else
#define RECEIVE_SIZE 128u /* of 2 kB: a host that waits for its answers sends no more than 55 at once */
#define RECEIVED_VECTOR USART_RX_vect
#endif

static volatile uint32_t milliseconds;
static volatile uint8_t received[RECEIVE_SIZE];
static volatile uint8_t received_head;
static uint8_t received_tail;

static gh_board board;
static gh_buses buses;
static gh_sensors sensors;
static uint8_t output_pins[GH_OUTPUTS];
static uint8_t inverted_outputs;
static bool has_wire;

/* Both survive the clearing of .bss. MCUSR has to be read, and the watchdog stopped, before main; a bootloader may have
 * cleared MCUSR, then the cause is unknown. The watchdog also ends a program that wants to start anew. */
#define WANTED_RESET 0x5AA5u
static uint8_t reset_flags __attribute__((section(".noinit")));
static uint16_t wanted_reset __attribute__((section(".noinit")));

void keep_reset_flags(void) __attribute__((naked, used, section(".init3")));
void keep_reset_flags(void)
{
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

ISR(TIMER0_COMPA_vect)
{
    milliseconds++;
}

ISR(RECEIVED_VECTOR)
{
    uint8_t head = received_head;
    received[head] = UDR0; /* a lap too far damages frames, and their CRC tells */
    received_head = (uint8_t)(head + 1u) % RECEIVE_SIZE;
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

/* When the power comes the brown-out detector may have seen it too low on its way up, and memory holds anything. */
static uint8_t reset_cause(void)
{
    bool wanted = wanted_reset == WANTED_RESET;
    wanted_reset = 0;
    if (reset_flags & _BV(PORF)) {
        return GH_RESET_CAUSE_POWER_ON;
    }
    if (reset_flags & _BV(BORF)) {
        return GH_RESET_CAUSE_BROWN_OUT;
    }
    if (wanted) {
        return GH_RESET_CAUSE_SOFTWARE;
    }
    if (reset_flags & _BV(WDRF)) {
        return GH_RESET_CAUSE_WATCHDOG;
    }
    return reset_flags & _BV(EXTRF) ? GH_RESET_CAUSE_EXTERNAL : GH_RESET_CAUSE_UNKNOWN;
}

static void drive_output(gh_output output, bool on)
{
    uint8_t number = output_pins[output];
    bool inverted = (inverted_outputs >> output & 1u) != 0;
    if (number != GH_NO_PIN) {
        gh_pin_drive(gh_pin_at(number), on != inverted ? GH_LEVEL_HIGH : GH_LEVEL_LOW);
    }
}

static void drive(const gh_pins *pins)
{
    drive_output(GH_OUTPUT_HEATER, pins->heater_relay);
    drive_output(GH_OUTPUT_FAN, pins->fan);
    drive_output(GH_OUTPUT_VALVE, pins->valve);
    drive_output(GH_OUTPUT_CUTOFF, !pins->cutoff_open); /* its relay closes the heater's supply */
    gh_led_drive(output_pins[GH_OUTPUT_LED], pins->led_pct, (inverted_outputs >> GH_OUTPUT_LED & 1u) != 0);
}

/* One whole pass: in turn with the driver's steps, which reads again what that may spoil. */
static uint64_t find_part(void *context, bool first)
{
    static gh_one_wire_search search;
    uint64_t rom = 0;
    (void)context;
    if (!has_wire) {
        return 0;
    }
    if (first) {
        gh_one_wire_search_init(&search, &buses.wire);
    }
    while (search.wire != NULL && gh_one_wire_search_step(&search, &rom) == GH_ONE_WIRE_SEARCH_RUNS) {
    }
    return rom;
}

static const gh_setup SETUP = {NULL, gh_eeprom_read_part, gh_eeprom_write_part, gh_eeprom_commit, find_part};

/* Every output off, the fan too: until the latches are read nobody knows whether it was stopped. */
static void start_outputs(const gh_config *config)
{
    for (uint8_t i = 0; i < GH_OUTPUTS; i++) {
        output_pins[i] = config->pins[i];
    }
    inverted_outputs = config->inverted;
    for (uint8_t i = 0; i < GH_OUTPUTS; i++) {
        drive_output((gh_output)i, false);
    }
    gh_led_start(output_pins[GH_OUTPUT_LED]);
}

static uint8_t wire_pin(const gh_config *config)
{
    for (uint8_t i = 0; i < config->part_count; i++) {
        if (config->parts[i].kind == GH_PART_DS18B20) {
            return config->parts[i].pin;
        }
    }
    return GH_NO_PIN;
}

/* A function of its own, so that the stack forgets the configuration. */
static __attribute__((noinline)) void configure(void)
{
    gh_config config;
    uint8_t latches[GH_PERSISTENT_SIZE];
    bool configured = gh_eeprom_config(&config);
    config.board.firmware_major = FIRMWARE_MAJOR;
    config.board.firmware_minor = FIRMWARE_MINOR;
    config.board.firmware_patch = FIRMWARE_PATCH;
    config.board.capabilities = gh_config_capabilities(&config) | GH_CAPABILITY_CONFIGURABLE |
                                GH_CAPABILITY_FAN_TIME;
    start_outputs(&config);
    gh_eeprom_read_latches(latches);
    gh_board_init(&board, &config.board, latches, reset_cause(), gh_eeprom_count_start());
    gh_board_use_setup(&board, &SETUP);
    if (configured) {
        gh_buses_start(&buses, wire_pin(&config));
        has_wire = wire_pin(&config) != GH_NO_PIN;
    }
    gh_sensors_init(&sensors, &config, &buses, 0);
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

static bool send_byte(void)
{
    uint8_t byte;
    if ((UCSR0A & _BV(UDRE0)) == 0) {
        return true;
    }
    bool sent = gh_board_transmit(&board, &byte, 1) == 1;
    if (sent) {
        UDR0 = byte;
    }
    return sent;
}

static void exchange_bytes(void)
{
    uint8_t head = received_head; /* what comes meanwhile waits for the next round, or step would starve */
    while (received_tail != head) {
        gh_board_receive(&board, received[received_tail], now());
        received_tail = (uint8_t)(received_tail + 1u) % RECEIVE_SIZE;
        send_byte(); /* as fast as bytes come: a line full of requests would else starve the answers */
    }
    send_byte();
}

/* The pins stand before the write begins: it takes 3.4 ms a byte. */
static void keep_latches(void)
{
    uint8_t latches[GH_PERSISTENT_SIZE];
    gh_board_persistent(&board, latches);
    gh_eeprom_keep_latches(latches);
}

/* The answer goes out, then the watchdog ends this program. */
static void start_anew(void)
{
    while (send_byte()) {
    }
    wanted_reset = WANTED_RESET;
    for (;;) {
    }
}

int main(void)
{
    uint32_t fed_ms = 0;

    wdt_enable(WDTO_250MS);
    configure();
    gh_pins pins = gh_board_step(&board, 0);
    drive(&pins);
    start_clock();
    start_uart();
    sei();
    for (;;) {
        exchange_bytes();
        uint32_t now_ms = now();
        if (now_ms != fed_ms) { /* a loop that hangs or a clock that stands, which no lease would end by, resets */
            fed_ms = now_ms;
            wdt_reset(); /* here only */
        }
        gh_sensors_step(&sensors, &board, now_ms);
        pins = gh_board_step(&board, now_ms);
        drive(&pins);
        keep_latches();
        if (board.restart) {
            start_anew();
        }
    }
}
