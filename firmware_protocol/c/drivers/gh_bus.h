/* The buses that sensors hang on, as a driver sees them. A board fills in the functions; a test puts simulated parts
 * behind them. No call takes longer than 2 ms or keeps interrupts off longer than 80 us: the serial line loses a byte
 * after 170 us, and leases are timed by an interrupt each millisecond. */
#ifndef GH_BUS_H
#define GH_BUS_H

#include <stdbool.h>
#include <stdint.h>

#include "gh_board.h"

typedef enum {
    GH_BUS_OK,
    GH_BUS_SILENT, /* nobody acknowledged, or no presence pulse */
    GH_BUS_STUCK,  /* a line stays low; nine clocks did not free it */
    GH_BUS_SLOW    /* a part stretched the clock for longer than 1 ms */
} gh_bus_result;

/* I2C at 100 kHz: a byte takes 90 us, so a transfer of at most 18 bytes fits. */
typedef struct {
    void *context;
    /* Writes `out`, then reads `in` after a repeated start; either may be empty. `in` is undefined unless OK. */
    gh_bus_result (*transfer)(void *context, uint8_t address, const uint8_t *out, uint8_t out_size, uint8_t *in,
                              uint8_t in_size);
} gh_i2c;

/* 1-Wire at standard speed: a reset takes 1 ms, a slot 70 us. */
typedef struct {
    void *context;
    gh_bus_result (*reset)(void *context); /* OK: somebody is present */
    /* Writes one bit; a 1 is a read slot too, and the line's level in it is returned. */
    bool (*slot)(void *context, bool bit);
} gh_one_wire;

typedef enum { GH_LEVEL_LOW, GH_LEVEL_HIGH, GH_LEVEL_RELEASED /* an input with a pull-up */ } gh_level;

#define GH_PULSE_MAX_US 65535u

/* Single pins, by the number that the board gives them. */
typedef struct {
    void *context;
    void (*drive)(void *context, uint8_t pin, gh_level level);
    bool (*is_high)(void *context, uint8_t pin);
    void (*pulse)(void *context, uint8_t pin, uint8_t high_us); /* drives low again after at least that time */
    /* Forgets what was heard, and from now on times every high level of the pin, by an interrupt. */
    void (*listen)(void *context, uint8_t pin);
    /* Copies the lengths [us] of the high levels that ended, oldest first, at most `size`; returns how many ended. */
    uint8_t (*heard)(void *context, uint16_t *high_us, uint8_t size);
    uint16_t (*analog)(void *context, uint8_t channel); /* 0..1023 of the supply */
} gh_lines;

/* What a driver found: a raw integer in the unit of its signal (gh_signal), or GH_NO_VALUE with the reason. */
typedef struct {
    int32_t raw;
    uint8_t quality; /* GH_QUALITY_... */
} gh_measurement;

#endif
