/* Drives one board from stdin, so that it can run under the sanitizers in a process of its own.
 *
 * Request: operation u8, now_ms u32, length u16, that many bytes. Answer: length u16, that many bytes.
 *   0 init: configuration as read below      -> transmitted bytes
 *   1 receive: bytes of the line             -> transmitted bytes
 *   2 sample: signal u8, quality u8, raw i32 -> nothing
 *   3 step                                   -> five bytes of pins, transmitted bytes
 *   4 persistent                             -> the four bytes
 *   6 two air sensors: first i32, second i32, verdict u8 -> nothing
 *   5 restart                                -> one byte: whether a reset is due
 *
 * The configuration's block starts blank; a good one is one for the ATmega328P.
 */
#include <stdio.h>
#include <string.h>

#include "gh_config.h"

#define LONGEST_REQUEST 1024u

typedef struct {
    uint8_t bytes[LONGEST_REQUEST * GH_MAX_FRAME];
    size_t length;
} answer;

static void drain(gh_board *board, answer *out)
{
    out->length += gh_board_transmit(board, out->bytes + out->length, sizeof out->bytes - out->length);
}

static uint8_t block[GH_BLOCK_SIZE], spare[GH_BLOCK_SIZE];

static void read_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    memcpy(bytes, block + part * 16, 16);
}

static void write_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    memcpy(spare + part * 16, bytes, 16);
}

static bool commit(void *context)
{
    gh_config config;
    (void)context;
    if (!gh_config_read(spare, GH_UNO, &config)) {
        return false;
    }
    memcpy(block, spare, sizeof block);
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

static void init(gh_board *board, const uint8_t *p)
{
    const gh_board_config config = {
        .board_id = gh_get_u64(p),
        .firmware_major = p[8],
        .firmware_minor = p[9],
        .firmware_patch = p[10],
        .capabilities = gh_get_u16(p + 11),
        .lease_max_ms = gh_get_u16(p + 13),
        .temp_trip = gh_get_i16(p + 15),
        .valve_pulse_max_ds = gh_get_u16(p + 17),
        .pwm_window_ds = gh_get_u16(p + 19),
        .report_period_ms = gh_get_u16(p + 21),
        .fan_safe_on = p[23] != 0,
    };
    memset(block, 0xFF, sizeof block);
    memset(spare, 0xFF, sizeof spare);
    gh_board_init(board, &config, p + 24, p[28], gh_get_u32(p + 29));
    gh_board_use_setup(board, &SETUP);
}

static void step(gh_board *board, uint32_t now_ms, answer *out)
{
    gh_pins pins = gh_board_step(board, now_ms);
    const uint8_t bytes[] = {pins.heater_relay, pins.fan, pins.led_pct, pins.valve, pins.cutoff_open};
    for (size_t i = 0; i < sizeof bytes; i++) {
        out->bytes[out->length++] = bytes[i];
    }
}

static void obey(gh_board *board, uint8_t operation, uint32_t now_ms, const uint8_t *body, size_t length, answer *out)
{
    switch (operation) {
    case 0:
        init(board, body);
        break;
    case 1:
        for (size_t i = 0; i < length; i++) {
            gh_board_receive(board, body[i], now_ms);
            drain(board, out);
        }
        break;
    case 2:
        gh_board_sample(board, (gh_signal)body[0], (int32_t)gh_get_u32(body + 2), body[1], now_ms);
        break;
    case 3:
        step(board, now_ms, out);
        break;
    case 6:
        gh_board_sample_pair(board, (int32_t)gh_get_u32(body), (int32_t)gh_get_u32(body + 4), body[8]);
        break;
    case 5:
        out->bytes[out->length++] = board->restart;
        return;
    default:
        gh_board_persistent(board, out->bytes);
        out->length = GH_PERSISTENT_SIZE;
        return;
    }
    drain(board, out);
}

int main(void)
{
    static gh_board board;
    static answer out;
    uint8_t head[7], body[LONGEST_REQUEST];
    while (fread(head, sizeof head, 1, stdin) == 1) {
        size_t length = gh_get_u16(head + 5);
        if (length > sizeof body || fread(body, 1, length, stdin) != length) {
            return 2;
        }
        out.length = 0;
        obey(&board, head[0], gh_get_u32(head + 1), body, length, &out);
        uint8_t size[2];
        gh_put_u16(size, (uint16_t)out.length);
        fwrite(size, sizeof size, 1, stdout);
        fwrite(out.bytes, 1, out.length, stdout);
        fflush(stdout);
    }
    return 0;
}
