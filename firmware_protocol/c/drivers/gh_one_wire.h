/* Bytes on a 1-Wire bus, and the search for the parts on it. An id is the 64-bit ROM code, first bit on the wire
 * lowest: family in the low byte, CRC in the high one. Datasheet: Maxim DS18B20 19-7487, "64-Bit Lasered ROM Code",
 * "CRC Generation", "ROM Commands". */
#ifndef GH_ONE_WIRE_H
#define GH_ONE_WIRE_H

#include "gh_bus.h"

#define GH_ONE_WIRE_STEP_BYTES 2u /* 16 slots of 70 us are 1.1 ms: what one step may take on the bus */

#define GH_ONE_WIRE_MATCH_ROM 0x55u
#define GH_ONE_WIRE_SKIP_ROM 0xCCu
#define GH_ONE_WIRE_SEARCH_ROM 0xF0u

/* Lowest bit first. */
void gh_one_wire_write(const gh_one_wire *wire, uint8_t byte);
uint8_t gh_one_wire_read(const gh_one_wire *wire);

/* CRC-8/MAXIM-DOW: check value 0xA1. Over data and its CRC it is 0. */
uint8_t gh_one_wire_crc8(const uint8_t *data, uint8_t size);

typedef enum {
    GH_ONE_WIRE_SEARCH_RUNS,
    GH_ONE_WIRE_SEARCH_FOUND, /* *id is the next one */
    GH_ONE_WIRE_SEARCH_ENDED, /* all have been found */
    GH_ONE_WIRE_SEARCH_FAILED /* nobody is there, the bus is stuck, or it is disturbed again and again */
} gh_one_wire_search_result;

typedef struct {
    const gh_one_wire *wire;
    uint8_t rom[8];    /* of this pass; above `position`, of the pass before */
    uint8_t position;  /* 0: reset; 1: command; then 1 more than the bit asked for, which count from 1 */
    uint8_t fork;      /* the bit where this pass turns to 1 and the pass before turned to 0; 0 in the first pass */
    uint8_t next_fork; /* the last bit where this pass turned to 0 and there are parts with 1; 0: none */
    uint8_t failures;  /* of this pass */
    uint8_t end;       /* RUNS until it is ENDED or FAILED */
} gh_one_wire_search;

void gh_one_wire_search_init(gh_one_wire_search *s, const gh_one_wire *wire);

/* For the setup command; no driver may use the bus meanwhile. At most a reset or 15 slots a call, 15 calls an id.
 * After ENDED or FAILED it repeats that. Ids come once each, with the right CRC, of any family. A disturbance may end the
 * search or hide a part, as in every 1-Wire search: two searches that find the same are to be trusted. */
gh_one_wire_search_result gh_one_wire_search_step(gh_one_wire_search *s, uint64_t *id);

#endif
