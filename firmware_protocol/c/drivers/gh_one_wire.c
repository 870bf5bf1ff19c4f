#include "gh_one_wire.h"

#include <string.h>

#define CRC_POLYNOMIAL 0x8Cu /* X^8 + X^5 + X^4 + 1, lowest bit first */
#define ROM_BYTES 8u
#define ROM_BITS 64u
#define POSITION_RESET 0u
#define POSITION_COMMAND 1u
#define POSITION_BITS 2u
#define BITS_A_STEP 5u /* three slots each: two to read, one to write */
#define FAILURES_MAX 3u

void gh_one_wire_write(const gh_one_wire *wire, uint8_t byte)
{
    for (uint8_t i = 0; i < 8; i++) {
        wire->slot(wire->context, ((byte >> i) & 1) != 0);
    }
}

uint8_t gh_one_wire_read(const gh_one_wire *wire)
{
    uint8_t byte = 0;
    for (uint8_t i = 0; i < 8; i++) {
        byte = (uint8_t)((byte >> 1) | (wire->slot(wire->context, true) ? 0x80 : 0));
    }
    return byte;
}

uint8_t gh_one_wire_crc8(const uint8_t *data, uint8_t size)
{
    uint8_t crc = 0;
    for (uint8_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (uint8_t bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc & 1) != 0 ? (crc >> 1) ^ CRC_POLYNOMIAL : crc >> 1);
        }
    }
    return crc;
}

void gh_one_wire_search_init(gh_one_wire_search *s, const gh_one_wire *wire)
{
    memset(s, 0, sizeof *s);
    s->wire = wire;
}

/* Asks all parts still in the pass for one bit, then keeps those with the chosen value. False, and none kept, when
 * nobody answers or the answer contradicts the pass before. */
static bool search_bit(gh_one_wire_search *s, uint8_t number)
{
    const gh_one_wire *wire = s->wire;
    uint8_t *byte = &s->rom[(number - 1u) / 8u];
    uint8_t mask = (uint8_t)(1u << (number - 1u) % 8u);
    bool has_zero = !wire->slot(wire->context, true); /* all send the bit, then its complement; a 0 wins */
    bool has_one = !wire->slot(wire->context, true);
    bool one = number < s->fork ? (*byte & mask) != 0 : number == s->fork || !has_zero;
    if (one ? !has_one : !has_zero) {
        return false;
    }
    if (!one && has_one) {
        s->next_fork = number;
    }
    *byte = (uint8_t)(one ? *byte | mask : *byte & ~mask);
    wire->slot(wire->context, one);
    return true;
}

/* Begins the pass again, so that a single disturbance does not end the search. */
static gh_one_wire_search_result fail(gh_one_wire_search *s)
{
    s->position = POSITION_RESET;
    s->next_fork = 0;
    if (++s->failures == FAILURES_MAX) {
        s->end = GH_ONE_WIRE_SEARCH_FAILED;
    }
    return (gh_one_wire_search_result)s->end;
}

static gh_one_wire_search_result end_pass(gh_one_wire_search *s, uint64_t *id)
{
    if (s->rom[0] == 0 || gh_one_wire_crc8(s->rom, ROM_BYTES) != 0) { /* a bus stuck low has the right CRC: 0 */
        return fail(s);
    }
    *id = 0;
    for (uint8_t i = ROM_BYTES; i > 0; i--) {
        *id = (*id << 8) | s->rom[i - 1];
    }
    s->position = POSITION_RESET;
    s->fork = s->next_fork;
    s->next_fork = 0;
    s->failures = 0;
    if (s->fork == 0) {
        s->end = GH_ONE_WIRE_SEARCH_ENDED;
    }
    return GH_ONE_WIRE_SEARCH_FOUND;
}

gh_one_wire_search_result gh_one_wire_search_step(gh_one_wire_search *s, uint64_t *id)
{
    if (s->end != GH_ONE_WIRE_SEARCH_RUNS) {
        return (gh_one_wire_search_result)s->end;
    }
    if (s->position == POSITION_RESET) {
        if (s->wire->reset(s->wire->context) != GH_BUS_OK) {
            return fail(s);
        }
        s->position = POSITION_COMMAND;
        return GH_ONE_WIRE_SEARCH_RUNS;
    }
    if (s->position == POSITION_COMMAND) {
        gh_one_wire_write(s->wire, GH_ONE_WIRE_SEARCH_ROM);
        s->position = POSITION_BITS;
        return GH_ONE_WIRE_SEARCH_RUNS;
    }
    for (uint8_t i = 0; i < BITS_A_STEP && s->position < POSITION_BITS + ROM_BITS; i++) {
        if (!search_bit(s, (uint8_t)(s->position - POSITION_BITS + 1u))) {
            return fail(s);
        }
        s->position++;
    }
    return s->position < POSITION_BITS + ROM_BITS ? GH_ONE_WIRE_SEARCH_RUNS : end_pass(s, id);
}
