/* Feeds the C board with bytes, samples and configurations that chance makes, under the sanitizers.
 *
 *   board_fuzz BYTES SEED BLOCKS    BLOCKS: a file with valid blocks of an ATmega328P, one after the other
 *
 * Prints what happened, one number a line with its name. Ends with an abort where a rule is broken.
 */
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gh_config.h"
#include "gh_sensors.h"

#define BLOCKS_MAX 64u
#define PART 16u
#define KINDS 20u

static uint64_t state;
static uint8_t blocks[BLOCKS_MAX][GH_BLOCK_SIZE];
static size_t block_count;
static uint8_t in_force[GH_BLOCK_SIZE], spare[GH_BLOCK_SIZE], persistent[GH_PERSISTENT_SIZE];
static gh_board board;
static gh_sensors sensors;
static uint32_t now_ms;
static uint8_t seq;
static uint64_t fed, answered, committed, heated, starts;

static uint32_t chance(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)(state >> 16) % below;
}

static void fill(uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        bytes[i] = (uint8_t)chance(256);
    }
}

/* ---- buses whose parts answer anything */

static gh_bus_result any_result(void)
{
    return chance(4) > 0 ? GH_BUS_OK : (gh_bus_result)chance(4);
}

static gh_bus_result transfer(void *context, uint8_t address, const uint8_t *out, uint8_t out_size, uint8_t *in,
                              uint8_t in_size)
{
    (void)context, (void)address, (void)out;
    assert(out_size + in_size <= 18u);
    fill(in, in_size);
    if (in_size % 3u == 0 && chance(4) > 0) { /* the right CRC, as Sensirion's parts have it */
        for (uint8_t at = 0; at + 2u < in_size; at = (uint8_t)(at + 3u)) {
            uint8_t crc = 0xFF;
            for (uint8_t i = 0; i < 16; i++) {
                bool bit = (crc >> 7 ^ in[at + i / 8u] >> (7u - i % 8u) & 1u) != 0;
                crc = (uint8_t)(crc << 1 ^ (bit ? 0x31u : 0u));
            }
            in[at + 2u] = crc;
        }
    }
    return any_result();
}

static gh_bus_result reset_wire(void *context)
{
    (void)context;
    return any_result();
}

static bool slot(void *context, bool bit)
{
    (void)context;
    return bit && chance(2) > 0;
}

static void drive(void *context, uint8_t pin, gh_level level)
{
    (void)context, (void)level;
    assert(pin < 20);
}

static bool is_high(void *context, uint8_t pin)
{
    (void)context, (void)pin;
    return chance(8) > 0;
}

static void pulse(void *context, uint8_t pin, uint8_t high_us)
{
    (void)context, (void)pin, (void)high_us;
}

static void listen(void *context, uint8_t pin)
{
    (void)context, (void)pin;
}

static uint8_t heard(void *context, uint16_t *high_us, uint8_t size)
{
    uint8_t count = (uint8_t)chance(4) > 0 ? (uint8_t)(chance(3) + 40u) : (uint8_t)chance(256);
    (void)context;
    for (uint8_t i = 0; i < count && i < size; i++) {
        high_us[i] = (uint16_t)(chance(4) > 0 ? (chance(2) > 0 ? 26u : 70u) : chance(65536));
    }
    return count;
}

static uint16_t analog(void *context, uint8_t channel)
{
    (void)context, (void)channel;
    return (uint16_t)chance(1024);
}

static const gh_buses BUSES = {
    {NULL, transfer}, {NULL, reset_wire, slot}, {NULL, drive, is_high, pulse, listen, heard, analog}};

/* ---- the configuration, and a start with it */

static void read_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    assert(part < GH_BLOCK_SIZE / PART);
    memcpy(bytes, in_force + part * PART, PART);
}

static void write_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    assert(part < GH_BLOCK_SIZE / PART);
    memcpy(spare + part * PART, bytes, PART);
}

static bool commit(void *context)
{
    gh_config config;
    (void)context;
    if (!gh_config_read(spare, GH_UNO, &config)) {
        return false;
    }
    memcpy(in_force, spare, sizeof in_force);
    committed++;
    return true;
}

static uint64_t find_part(void *context, bool first)
{
    static uint64_t rom;
    (void)context;
    rom = first ? 0x28 : rom + 0x100;
    return rom > 0x228 ? 0 : rom;
}

static const gh_setup SETUP = {NULL, read_part, write_part, commit, find_part};

static void start_board(void)
{
    gh_config config;
    starts++;
    if (!gh_config_read(in_force, GH_UNO, &config)) {
        memset(&config, 0, sizeof config);
        memset(config.pins, GH_NO_PIN, sizeof config.pins);
    }
    config.board.capabilities = gh_config_capabilities(&config) | GH_CAPABILITY_CONFIGURABLE;
    if (chance(4) == 0) {
        fill(persistent, sizeof persistent);
    }
    gh_board_init(&board, &config.board, persistent, (uint8_t)chance(8), chance(UINT32_MAX));
    gh_board_use_setup(&board, &SETUP);
    now_ms = chance(2) > 0 ? 0 : UINT32_MAX - chance(100000);
    gh_sensors_init(&sensors, &config, &BUSES, now_ms);
}

/* ---- what comes over the line */

static void feed(const uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        uint8_t out[GH_TRANSMIT_SIZE];
        gh_board_receive(&board, bytes[i], now_ms);
        answered += gh_board_transmit(&board, out, sizeof out) > 0;
        assert(board.waiting == 0);
    }
    fed += size;
}

static void send_payload(uint8_t kind, const uint8_t *body, size_t size)
{
    uint8_t payload[GH_MAX_PAYLOAD] = {GH_PROTOCOL_VERSION, kind, 0, 0}, frame[GH_MAX_FRAME + 1];
    seq = seq < 255 ? (uint8_t)(seq + 1) : 1;
    payload[2] = chance(8) > 0 ? seq : (uint8_t)chance(256);
    payload[0] = chance(64) > 0 ? payload[0] : (uint8_t)chance(256);
    memcpy(payload + GH_HEADER_LENGTH, body, size);
    size_t length = gh_frame_encode(payload, GH_HEADER_LENGTH + size, frame);
    if (chance(16) == 0) {
        frame[chance((uint32_t)length)] ^= (uint8_t)(1u << chance(8));
    }
    feed(frame, length);
}

static void send_request(void)
{
    static const uint8_t lengths[KINDS] = {0, 4, GH_HELLO_LENGTH, GH_SENSOR_REPORT_LENGTH, GH_COMMAND_LENGTH,
                                           GH_STATE_ECHO_LENGTH, 0, 0, 2, 0, 0, 0, 0, 1, 17, 0, 17, 1, 8};
    uint8_t body[GH_MAX_BODY], kind = (uint8_t)chance(KINDS);
    fill(body, sizeof body);
    kind = chance(8) == 0 ? GH_KIND_HELLO_REQUEST : chance(8) == 0 ? GH_KIND_COMMAND : kind;
    if (kind == GH_KIND_COMMAND && chance(4) > 0) {
        const gh_command command = {(uint8_t)chance(21), (uint8_t)chance(2), (uint8_t)chance(101),
                                    (uint8_t)chance(256), (uint8_t)chance(2), (uint16_t)chance(60001)};
        gh_pack_command(&command, body);
    }
    send_payload(kind, body, chance(16) > 0 ? lengths[kind] : chance(GH_MAX_BODY + 1));
}

/* A block that was good once, with some bytes changed and mostly the right CRC again. */
static void send_block(void)
{
    uint8_t block[GH_BLOCK_SIZE], body[1 + PART];
    memcpy(block, blocks[chance((uint32_t)block_count)], sizeof block);
    for (uint32_t left = chance(4); left > 0; left--) {
        block[chance(GH_BLOCK_SIZE)] = (uint8_t)chance(256);
    }
    if (chance(8) > 0) {
        gh_put_u16(block, gh_crc16(block + 2, GH_BLOCK_SIZE - 2));
    }
    const gh_command cold = {0};
    gh_pack_command(&cold, body);
    send_payload(GH_KIND_COMMAND, body, GH_COMMAND_LENGTH);
    for (uint8_t part = 0; part < GH_BLOCK_SIZE / PART; part++) {
        body[0] = part;
        memcpy(body + 1, block + part * PART, PART);
        send_payload(GH_KIND_BLOCK_WRITE, body, sizeof body);
    }
    send_payload(GH_KIND_BLOCK_COMMIT, body, 0);
}

static void send_noise(void)
{
    uint8_t bytes[256];
    size_t size = chance(sizeof bytes);
    fill(bytes, size);
    feed(bytes, size);
}

static void let_time_pass(void)
{
    now_ms += chance(8) > 0 ? chance(120) : chance(20000);
    for (uint32_t rounds = chance(12); rounds > 0; rounds--) {
        gh_sensors_step(&sensors, &board, now_ms++);
    }
    if (chance(4) == 0) {
        gh_board_sample(&board, (gh_signal)chance(GH_SIGNAL_COUNT), (int32_t)chance(UINT32_MAX), (uint8_t)chance(256),
                        now_ms);
    }
    if (chance(4) > 0) {
        gh_board_sample(&board, GH_SIGNAL_TEMP_AIR, 2500, GH_QUALITY_GOOD, now_ms);
    }
    gh_pins pins = gh_board_step(&board, now_ms);
    assert(!pins.heater_relay || (board.safety.latches == 0 && board.safety.greeted));
    heated += pins.heater_relay;
    gh_board_persistent(&board, persistent);
}

int main(int argc, char **argv)
{
    if (argc != 4) {
        return 2;
    }
    FILE *file = fopen(argv[3], "rb");
    block_count = file == NULL ? 0 : fread(blocks, GH_BLOCK_SIZE, BLOCKS_MAX, file);
    if (block_count == 0) {
        return 2;
    }
    fclose(file);
    uint64_t wanted = strtoull(argv[1], NULL, 10);
    state = strtoull(argv[2], NULL, 10) * 2654435761u + 88172645463325252u;
    memset(persistent, 0xFF, sizeof persistent);
    memcpy(in_force, blocks[0], sizeof in_force);
    start_board();
    while (fed < wanted) {
        uint32_t what = chance(16);
        if (what == 0) {
            send_block();
        } else if (what < 3) {
            send_noise();
        } else {
            send_request();
        }
        let_time_pass();
        if (board.restart || chance(2000) == 0) {
            start_board();
        }
    }
    printf("bytes %llu\nanswers %llu\nconfigurations %llu\nstarts %llu\nsteps with heat %llu\n", (unsigned long long)fed,
           (unsigned long long)answered, (unsigned long long)committed, (unsigned long long)starts,
           (unsigned long long)heated);
    return 0;
}
