/* Runs the board's program in simavr; a test holds the other end of its line, and its clock.
 *
 *   avr_host MICROCONTROLLER board.elf|flash.bin [RESET_ADDRESS]
 *
 * An address is that of a bootloader, where the fuses of an Arduino let every reset begin.
 *
 * Request on stdin: operation u8, argument u32, length u16, that many bytes. Answer on stdout: length u32, bytes.
 *   a  run `argument` cycles; the bytes go onto the line from now on
 *                                         -> cycle u64, then events: cycle u64, kind, port (letter or 0), value
 *   r  data memory from `argument`, length u16 in the bytes          -> that memory
 *   w  write the bytes to data memory at `argument`                  -> nothing
 *   g  all of the EEPROM                                             -> its bytes
 *   p  set the EEPROM from `argument` on                             -> nothing
 *   x  external reset                                                -> nothing
 *   f  from now on time the function at flash address `argument`     -> nothing
 *   m  what was measured                                             -> struct measured
 *   v  the voltage [mV] at analog channel `argument`, u16            -> nothing
 *   i  level of a pin from outside: port letter, bit, level          -> nothing
 *   b  pins whose levels the parts outside want to know: pairs of port letter and mask -> nothing
 *   t  there are parts on the I2C bus                                -> nothing
 *
 * While it runs the program asks the parts outside: length u32 with its highest bit set, kind u8, cycle u64, bytes. Each
 * question is answered on stdin: length u16, bytes.
 *   L  port letter, bit, level 0 low, 1 high, 2 let go by the microcontroller
 *                            -> levels to come: after so many cycles u32, port letter, bit, level
 *   A  I2C address, 1 for reading -> 1 where a part acknowledges, and its bytes for reading
 *   S  I2C address, bytes written; the transfer has ended -> nothing
 */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_twi.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

DEFINE_FIFO(uint16_t, uart_fifo);

#define FREQUENCY 16000000u
#define LINE_BYTE_CYCLES 1389u /* 10 bits at 115200 baud */
#define UART_BITS 10u
#define UART_PENDING_MAX 3u    /* two in the receiver's buffer, one in its shift register */
#define EEPROM_WRITE_US 3400u
#define TWCR 0xBC
#define TWINT_BIT 0x80
#define EECR 0x3F
#define EEPE 0x02
#define UBRR0L 0xC4
#define EVENT_SIZE 11u
#define SUPPLY_MV 5000u
#define PORTS 12u /* A to L */
#define QUESTION 0x80000000u
#define LEVELS_MAX 256u
#define LEVEL_SIZE 7u
#define I2C_BYTES_MAX 32u
#define I2C_SLOWER 10u /* simavr counts a microsecond for a clock of 100 kHz */
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
typedef struct {
    uint8_t direction, output; /* as last told */
    uint8_t watched;           /* bits that the parts outside want to know */
    uint8_t outside, outside_levels; /* bits whose level a part outside gives */
} port_state;

typedef struct {
    uint64_t cycle;
    uint8_t port, bit, level;
} planned_level;

static port_state ports[PORTS];
static planned_level levels[LEVELS_MAX];
static size_t level_count;
static struct {
    avr_twi_t *unit;
    avr_irq_t *irq;
    uint8_t address; /* of the transfer under way, 0: none; the lowest bit is set for reading */
    uint8_t bytes[I2C_BYTES_MAX];
    uint8_t length, taken;
} i2c;
static function functions[WATCHED_MAX];
static size_t function_count;
static struct {
    uint32_t lowest_stack, lost_bytes;
    uint64_t longest_without_interrupts;
} measured;
static uint64_t interrupts_off_since;
static bool interrupts_were_on;

static void tell_of(uint8_t kind, uint8_t port, uint8_t value)
{
    if (events_length + EVENT_SIZE > events_room) {
        events_room = events_room * 2 + 1024;
        events = realloc(events, events_room);
    }
    memcpy(events + events_length, &avr->cycle, 8);
    events[events_length + 8] = kind;
    events[events_length + 9] = port;
    events[events_length + 10] = value;
    events_length += EVENT_SIZE;
}

static void tell(uint8_t kind, uint8_t value)
{
    tell_of(kind, 0, value);
}

/* Asks the parts outside; returns the length of what they say. */
static uint16_t ask(uint8_t kind, const uint8_t *bytes, size_t length, uint8_t *said, size_t room)
{
    uint32_t size = (uint32_t)(9u + length) | QUESTION;
    uint16_t answered = 0;
    fwrite(&size, sizeof size, 1, answers);
    fwrite(&kind, 1, 1, answers);
    fwrite(&avr->cycle, 8, 1, answers);
    fwrite(bytes, 1, length, answers);
    fflush(answers);
    if (fread(&answered, sizeof answered, 1, stdin) != 1 || answered > room ||
        fread(said, 1, answered, stdin) != answered) {
        exit(4);
    }
    return answered;
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

/* A part outside is stronger than the pull-up of a pin, which simavr would else put through at each write to the port. */
static void set_level(uint8_t port, uint8_t bit, uint8_t level)
{
    port_state *state = &ports[port - 'A'];
    state->outside |= (uint8_t)(1 << bit);
    state->outside_levels = (uint8_t)((state->outside_levels & ~(1 << bit)) | level << bit);
    avr_ioport_external_t external = {.name = port, .mask = state->outside, .value = state->outside_levels};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &external);
    if ((state->direction >> bit & 1) == 0) {
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), level);
    }
}

static avr_cycle_count_t pass_levels(avr_t *mcu, avr_cycle_count_t when, void *param)
{
    (void)when, (void)param;
    for (;;) {
        size_t next = 0;
        for (size_t i = 1; i < level_count; i++) {
            next = levels[i].cycle < levels[next].cycle ? i : next;
        }
        if (level_count == 0) {
            return 0;
        }
        planned_level due = levels[next];
        if (due.cycle > mcu->cycle) {
            return due.cycle;
        }
        levels[next] = levels[--level_count];
        set_level(due.port, due.bit, due.level);
    }
}

static void plan_levels(const uint8_t *said, uint16_t length)
{
    for (uint16_t at = 0; at + LEVEL_SIZE <= length && level_count < LEVELS_MAX; at += LEVEL_SIZE) {
        uint32_t after;
        memcpy(&after, said + at, sizeof after);
        levels[level_count++] = (planned_level){avr->cycle + after, said[at + 4], said[at + 5], said[at + 6]};
    }
    avr_cycle_timer_cancel(avr, pass_levels, NULL);
    avr_cycle_timer_register(avr, 1, pass_levels, NULL);
}

/* What the microcontroller does to a pin: 0 low, 1 high, 2 nothing. */
static uint8_t driven(uint8_t direction, uint8_t output, uint8_t bit)
{
    return (direction >> bit & 1) == 0 ? 2 : output >> bit & 1;
}

static void ask_about_levels(uint8_t port, port_state before, port_state now)
{
    uint8_t said[LEVELS_MAX * LEVEL_SIZE];
    for (uint8_t bit = 0; bit < 8; bit++) {
        uint8_t level = driven(now.direction, now.output, bit);
        if ((now.watched >> bit & 1) != 0 && level != driven(before.direction, before.output, bit)) {
            const uint8_t question[] = {port, bit, level};
            plan_levels(said, ask('L', question, sizeof question, said, sizeof said));
        }
    }
}

static void on_port(uint8_t port, bool is_output, uint8_t value)
{
    port_state *state = &ports[port - 'A'], before = *state;
    uint8_t *told = is_output ? &state->output : &state->direction;
    if (*told != value) {
        *told = value;
        tell_of(is_output ? 'P' : 'D', port, value);
        ask_about_levels(port, before, *state);
    }
}

static void on_output(avr_irq_t *irq, uint32_t value, void *port)
{
    (void)irq;
    on_port((uint8_t)(uintptr_t)port, true, (uint8_t)value);
}

static void on_direction(avr_irq_t *irq, uint32_t value, void *port)
{
    (void)irq;
    on_port((uint8_t)(uintptr_t)port, false, (uint8_t)value);
}

/* simavr leaves the flag set that a program clears by writing it. */
static void on_i2c_control(avr_t *mcu, avr_io_addr_t address, uint8_t value, void *param)
{
    (void)address, (void)param;
    if (value & TWINT_BIT) {
        mcu->data[TWCR] &= (uint8_t)~TWINT_BIT;
    }
}

static void on_i2c(avr_irq_t *irq, uint32_t value, void *param)
{
    avr_twi_msg_irq_t message = {.u.v = value};
    uint8_t what = message.u.twi.msg, said[1 + I2C_BYTES_MAX];
    (void)irq, (void)param;
    avr->frequency = FREQUENCY * I2C_SLOWER; /* until the end of this instruction */
    if ((what & (TWI_COND_STOP | TWI_COND_START)) != 0 && i2c.address != 0 && (i2c.address & 1) == 0) {
        uint8_t question[1 + I2C_BYTES_MAX] = {i2c.address >> 1};
        memcpy(question + 1, i2c.bytes, i2c.length);
        ask('S', question, 1u + i2c.length, said, sizeof said);
    }
    if (what & (TWI_COND_STOP | TWI_COND_START)) {
        i2c.address = 0;
    }
    if (what & TWI_COND_START) {
        const uint8_t question[] = {message.u.twi.addr >> 1, message.u.twi.addr & 1};
        uint16_t length = ask('A', question, sizeof question, said, sizeof said);
        i2c.unit->state &= (uint8_t)~TWI_COND_WRITE; /* or simavr tells the status of a data byte */
        if (said[0] == 0) {
            return;
        }
        i2c.address = message.u.twi.addr;
        i2c.length = (uint8_t)(length - 1u);
        i2c.taken = 0;
        memcpy(i2c.bytes, said + 1, i2c.length);
        avr_raise_irq(i2c.irq + TWI_IRQ_INPUT, avr_twi_irq_msg(TWI_COND_ACK, i2c.address, 1));
    } else if (i2c.address != 0 && (what & TWI_COND_WRITE) != 0) {
        if (i2c.length < I2C_BYTES_MAX) {
            i2c.bytes[i2c.length++] = message.u.twi.data;
        }
        avr_raise_irq(i2c.irq + TWI_IRQ_INPUT, avr_twi_irq_msg(TWI_COND_ACK, i2c.address, 1));
    } else if (i2c.address != 0 && (what & TWI_COND_READ) != 0) {
        uint8_t byte = i2c.taken < i2c.length ? i2c.bytes[i2c.taken++] : 0xFF; /* nobody holds the line low */
        avr_raise_irq(i2c.irq + TWI_IRQ_INPUT, avr_twi_irq_msg(TWI_COND_READ, i2c.address, byte));
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
    for (size_t i = 0; i < PORTS; i++) {
        ports[i].direction = ports[i].output = 0;
    }
    level_count = 0;
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
        avr->frequency = FREQUENCY;
        measure();
        if (state == cpu_Crashed || state == cpu_Done) {
            tell('C', (uint8_t)state);
            break;
        }
    }
    memcpy(events, &avr->cycle, 8);
    answer(events, (uint32_t)events_length);
}

/* The first unit of a kind: an avr_io_t with more behind it. */
static void *unit_of(const char *kind)
{
    for (avr_io_t *io = avr->io_port; io != NULL; io = io->next) {
        if (strcmp(io->kind, kind) == 0 && (strcmp(kind, "uart") != 0 || ((avr_uart_t *)io)->name == '0')) {
            return io;
        }
    }
    exit(3);
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
    case 'v':
        memcpy(&wanted, bytes, sizeof wanted);
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, (int)argument), wanted); /* 0 to 7: all that simavr has */
        break;
    case 'i':
        set_level(bytes[0], bytes[1], bytes[2]);
        break;
    case 'b':
        for (uint16_t i = 0; i + 1 < length; i += 2) {
            ports[bytes[i] - 'A'].watched = bytes[i + 1];
        }
        break;
    case 't':
        i2c.unit = unit_of("twi");
        i2c.irq = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), 0);
        avr_irq_register_notify(i2c.irq + TWI_IRQ_OUTPUT, on_i2c, NULL);
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

static bool load(const char *path)
{
    elf_firmware_t firmware = {0};
    if (strcmp(path + strlen(path) - 4, ".bin") == 0) {
        FILE *image = fopen(path, "rb");
        size_t size = image == NULL ? 0 : fread(avr->flash, 1, avr->flashend + 1u, image);
        avr->codeend = avr->flashend;
        return size > 0 && fclose(image) == 0;
    }
    if (elf_read_firmware(path, &firmware) != 0) {
        return false;
    }
    firmware.eeprom = NULL; /* flashing a program leaves the EEPROM alone */
    firmware.eesize = 0;
    avr_load_firmware(avr, &firmware);
    return true;
}

static void start(const char *microcontroller, const char *path, uint32_t reset_address)
{
    avr = avr_make_mcu_by_name(microcontroller);
    if (avr == NULL) {
        exit(2);
    }
    avr_init(avr);
    if (!load(path)) {
        exit(2);
    }
    avr->reset_pc = avr->pc = reset_address;
    avr->frequency = FREQUENCY;
    avr->vcc = avr->avcc = avr->aref = SUPPLY_MV;
    core_reset = avr->reset;
    avr->reset = on_reset;
    uart = unit_of("uart");
    uart->flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_irq_register_notify(uart->io.irq + UART_IRQ_OUTPUT, on_transmit, NULL);
    for (uintptr_t port = 'A'; port < 'A' + PORTS; port++) {
        avr_irq_t *irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), 0);
        if (irq != NULL) {
            avr_irq_register_notify(irq + IOPORT_IRQ_REG_PORT, on_output, (void *)port);
            avr_irq_register_notify(irq + IOPORT_IRQ_DIRECTION_ALL, on_direction, (void *)port);
        }
    }
    avr_register_io_write(avr, EECR, on_eeprom, NULL);
    avr_register_io_write(avr, TWCR, on_i2c_control, NULL);
    measured.lowest_stack = avr->ramend;
    events_room = 1024;
    events = malloc(events_room);
}

int main(int argc, char **argv)
{
    static uint8_t bytes[UINT16_MAX];
    uint8_t head[7];
    if (argc != 3 && argc != 4) {
        return 2;
    }
    answers = fdopen(dup(STDOUT_FILENO), "wb");
    dup2(STDERR_FILENO, STDOUT_FILENO); /* simavr talks */
    start(argv[1], argv[2], argc == 4 ? (uint32_t)strtoul(argv[3], NULL, 0) : 0);
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
