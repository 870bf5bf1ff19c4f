/* Runs the board's program in simavr; a test holds the other end of its line, and its clock.
 *
 *   avr_host board.elf
 *
 * Request on stdin: operation u8, argument u32, length u16, that many bytes. Answer on stdout: length u32, bytes.
 *   a  run `argument` cycles; the bytes go onto the line from now on -> cycle u64, then events: cycle u64, kind, value
 *   r  data memory from `argument`, length u16 in the bytes          -> that memory
 *   w  write the bytes to data memory at `argument`                  -> nothing
 *   g  all of the EEPROM                                             -> its bytes
 *   p  set the EEPROM from `argument` on                             -> nothing
 *   x  external reset                                                -> nothing
 *   f  from now on time the function at flash address `argument`     -> nothing
 *   m  what was measured                                             -> struct measured
 */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_eeprom.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

DEFINE_FIFO(uint16_t, uart_fifo);

#define FREQUENCY 16000000u
#define LINE_BYTE_CYCLES 1389u /* 10 bits at 115200 baud */
#define UART_BITS 10u
#define UART_PENDING_MAX 3u    /* two in the receiver's buffer, one in its shift register */
#define EEPROM_WRITE_US 3400u
#define PORTA 0x22
#define DDRA 0x21
#define EECR 0x3F
#define EEPE 0x02
#define UBRR0L 0xC4
#define EVENT_SIZE 10u
#define WATCHED_MAX 8u

typedef struct {
    uint32_t address;
    uint32_t calls;
    uint64_t started, total, longest; /* [cycles], interrupts included */
    uint32_t stack;                   /* 0: not running */
} function;

static FILE *answers;
static avr_t *avr;
static void (*core_reset)(avr_t *mcu);
static avr_uart_t *uart;
static uint8_t *line, *events;
static size_t line_length, line_sent, events_length, events_room;
static uint8_t shown[2]; /* DDRA, PORTA as last told */
static function functions[WATCHED_MAX];
static size_t function_count;
static struct {
    uint32_t lowest_stack, lost_bytes;
    uint64_t longest_without_interrupts;
} measured;
static uint64_t interrupts_off_since;
static bool interrupts_were_on;

static void tell(uint8_t kind, uint8_t value)
{
    if (events_length + EVENT_SIZE > events_room) {
        events_room = events_room * 2 + 1024;
        events = realloc(events, events_room);
    }
    memcpy(events + events_length, &avr->cycle, 8);
    events[events_length + 8] = kind;
    events[events_length + 9] = value;
    events_length += EVENT_SIZE;
}

/* simavr counts a parity bit whether there is one or not. */
static void correct_byte_time(void)
{
    uart->cycles_per_byte = UART_BITS * 8 * (avr->data[UBRR0L] + 1u);
}

static void on_transmit(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    correct_byte_time();
    tell('T', (uint8_t)value);
}

static void on_pins(avr_t *mcu, avr_io_addr_t address, uint8_t value, void *param)
{
    (void)mcu, (void)param;
    if (shown[address - DDRA] != value) {
        shown[address - DDRA] = value;
        tell(address == PORTA ? 'P' : 'D', value);
    }
}

/* simavr writes at once; an EEPROM is busy for 3.4 ms. */
static avr_cycle_count_t eeprom_ready(avr_t *mcu, avr_cycle_count_t when, void *param)
{
    (void)when, (void)param;
    mcu->data[EECR] &= (uint8_t)~EEPE;
    return 0;
}

static void on_eeprom(avr_t *mcu, avr_io_addr_t address, uint8_t value, void *param)
{
    (void)address, (void)param;
    if (value & EEPE) {
        mcu->data[EECR] |= EEPE;
        avr_cycle_timer_register_usec(mcu, EEPROM_WRITE_US, eeprom_ready, NULL);
        tell('E', 0);
    }
}

static avr_cycle_count_t send_line_byte(avr_t *mcu, avr_cycle_count_t when, void *param)
{
    (void)mcu, (void)param;
    if (line_sent == line_length) {
        return 0;
    }
    correct_byte_time();
    if (uart_fifo_get_read_size(&uart->input) >= UART_PENDING_MAX) {
        measured.lost_bytes++;
    } else {
        avr_raise_irq(uart->io.irq + UART_IRQ_INPUT, line[line_sent]);
    }
    line_sent++;
    return when + LINE_BYTE_CYCLES;
}

static void on_reset(avr_t *mcu)
{
    core_reset(mcu);
    memset(shown, 0, sizeof shown);
    interrupts_were_on = false;
    for (size_t i = 0; i < function_count; i++) {
        functions[i].stack = 0;
    }
    avr_cycle_timer_register(mcu, LINE_BYTE_CYCLES, send_line_byte, NULL); /* the host knows of no reset */
    tell('R', 0);
}

static uint32_t stack_pointer(void)
{
    return avr->data[R_SPL] | (uint32_t)avr->data[R_SPH] << 8;
}

static void measure(void)
{
    uint32_t stack = stack_pointer();
    if (stack < measured.lowest_stack && stack > avr->ioend) {
        measured.lowest_stack = stack;
    }
    if (avr->sreg[S_I]) {
        interrupts_were_on = true;
        interrupts_off_since = avr->cycle;
    } else if (interrupts_were_on && avr->cycle - interrupts_off_since > measured.longest_without_interrupts) {
        measured.longest_without_interrupts = avr->cycle - interrupts_off_since;
    }
    for (size_t i = 0; i < function_count; i++) {
        function *f = &functions[i];
        if (f->stack == 0 && avr->pc == f->address) {
            f->stack = stack;
            f->started = avr->cycle;
        } else if (f->stack != 0 && stack > f->stack) { /* the return address is gone */
            uint64_t took = avr->cycle - f->started;
            f->total += took;
            f->calls++;
            f->longest = took > f->longest ? took : f->longest;
            f->stack = 0;
        }
    }
}

static void answer(const void *bytes, uint32_t length)
{
    fwrite(&length, sizeof length, 1, answers);
    fwrite(bytes, 1, length, answers);
    fflush(answers);
}

static void put_on_line(const uint8_t *bytes, size_t length)
{
    bool idle = line_sent == line_length;
    memmove(line, line + line_sent, line_length - line_sent);
    line_length -= line_sent;
    line_sent = 0;
    line = realloc(line, line_length + length + 1);
    memcpy(line + line_length, bytes, length);
    line_length += length;
    if (idle && length > 0) {
        avr_cycle_timer_register(avr, LINE_BYTE_CYCLES, send_line_byte, NULL);
    }
}

static void run(uint32_t cycles)
{
    events_length = 8;
    uint64_t end = avr->cycle + cycles;
    while (avr->cycle < end) {
        int state = avr_run(avr);
        measure();
        if (state == cpu_Crashed || state == cpu_Done) {
            tell('C', (uint8_t)state);
            break;
        }
    }
    memcpy(events, &avr->cycle, 8);
    answer(events, (uint32_t)events_length);
}

static void external_reset(void)
{
    avr_reset(avr);
    avr_regbit_set(avr, avr->reset_flags.extrf);
}

static void serve(uint8_t operation, uint32_t argument, uint8_t *bytes, uint16_t length)
{
    avr_eeprom_desc_t eeprom = {.ee = bytes, .offset = (uint16_t)argument, .size = length};
    uint16_t wanted = 0;
    switch (operation) {
    case 'a':
        put_on_line(bytes, length);
        run(argument);
        return;
    case 'r':
        memcpy(&wanted, bytes, sizeof wanted);
        answer(avr->data + argument, wanted);
        return;
    case 'w':
        memcpy(avr->data + argument, bytes, length);
        break;
    case 'g':
        eeprom = (avr_eeprom_desc_t){.ee = NULL, .offset = 0, .size = avr->e2end + 1u};
        avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &eeprom);
        answer(eeprom.ee, avr->e2end + 1u);
        return;
    case 'p':
        avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &eeprom);
        break;
    case 'x':
        external_reset();
        break;
    case 'f':
        functions[function_count++ % WATCHED_MAX] = (function){.address = argument};
        break;
    default: {
        uint8_t out[sizeof measured + sizeof functions];
        memcpy(out, &measured, sizeof measured);
        memcpy(out + sizeof measured, functions, sizeof functions);
        answer(out, (uint32_t)(sizeof measured + function_count * sizeof functions[0]));
        return;
    }
    }
    answer("", 0);
}

static avr_uart_t *first_uart(void)
{
    for (avr_io_t *io = avr->io_port; io != NULL; io = io->next) {
        if (strcmp(io->kind, "uart") == 0 && ((avr_uart_t *)io)->name == '0') {
            return (avr_uart_t *)io;
        }
    }
    exit(3);
}

static void start(const char *path)
{
    elf_firmware_t firmware = {0};
    avr = avr_make_mcu_by_name("atmega2560");
    if (avr == NULL || elf_read_firmware(path, &firmware) != 0) {
        exit(2);
    }
    avr_init(avr);
    firmware.frequency = FREQUENCY;
    firmware.eeprom = NULL; /* flashing a program leaves the EEPROM alone */
    firmware.eesize = 0;
    avr_load_firmware(avr, &firmware);
    core_reset = avr->reset;
    avr->reset = on_reset;
    uart = first_uart();
    uart->flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_irq_register_notify(uart->io.irq + UART_IRQ_OUTPUT, on_transmit, NULL);
    avr_register_io_write(avr, PORTA, on_pins, NULL);
    avr_register_io_write(avr, DDRA, on_pins, NULL);
    avr_register_io_write(avr, EECR, on_eeprom, NULL);
    measured.lowest_stack = avr->ramend;
}

int main(int argc, char **argv)
{
    static uint8_t bytes[UINT16_MAX];
    uint8_t head[7];
    if (argc != 2) {
        return 2;
    }
    answers = fdopen(dup(STDOUT_FILENO), "wb");
    dup2(STDERR_FILENO, STDOUT_FILENO); /* simavr talks */
    start(argv[1]);
    while (fread(head, sizeof head, 1, stdin) == 1) {
        uint32_t argument;
        uint16_t length;
        memcpy(&argument, head + 1, sizeof argument);
        memcpy(&length, head + 5, sizeof length);
        if (fread(bytes, 1, length, stdin) != length) {
            return 2;
        }
        serve(head[0], argument, bytes, length);
    }
    return 0;
}
