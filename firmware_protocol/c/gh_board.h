/* The board: bytes and samples in, pins and bytes out. Holds no pin, no clock, no global; see README.md. */
#ifndef GH_BOARD_H
#define GH_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "gh_frame.h"
#include "gh_messages.h"
#include "gh_safety.h"

#define GH_TRANSMIT_SIZE 192u        /* bytes that may wait for the line: four frames of the longest kind sent */
#define GH_ANSWER_SIZE GH_HELLO_LENGTH /* the longest body sent */
#define GH_NO_VALUE INT32_MIN

/* The signals a board may sample, in the order of sensor_report; fan_rpm travels in state_echo. */
typedef enum {
    GH_SIGNAL_TEMP_AIR,         /* 0.01 degC */
    GH_SIGNAL_REL_HUMIDITY,     /* 0.01 % */
    GH_SIGNAL_CO2,              /* ppm */
    GH_SIGNAL_LIGHT,            /* 0.0001 of full */
    GH_SIGNAL_SOIL_MOISTURE,    /* 0.0001 */
    GH_SIGNAL_TANK_LEVEL,       /* 0.0001 of full */
    GH_SIGNAL_TEMP_AMBIENT,     /* 0.01 degC */
    GH_SIGNAL_FAN_RPM,          /* 1/min */
    GH_SIGNAL_COUNT
} gh_signal;

/* Raw integers, in the ranges that the hello message gives. */
typedef struct {
    uint64_t board_id;
    uint8_t firmware_major, firmware_minor, firmware_patch;
    uint16_t capabilities;      /* GH_CAPABILITY_... */
    uint16_t lease_max_ms;
    int16_t temp_trip;          /* 0.01 degC */
    uint16_t valve_pulse_max_ds; /* 0.1 s */
    uint16_t pwm_window_ds;     /* 0.1 s */
    uint16_t report_period_ms;
    bool fan_safe_on;
} gh_board_config;

typedef struct {
    int32_t raw; /* GH_NO_VALUE: no number */
    uint32_t time_ms;
    uint8_t quality;
} gh_sample;

/* Two copies of the configuration's block (gh_config.h) behind block_read, block_write and block_commit: the one in
 * force, and a spare one; and the search for parts. Calls may take 60 ms: the heater is off. */
typedef struct {
    void *context;
    void (*read)(void *context, uint8_t part, uint8_t *bytes);  /* 16 bytes of the one in force */
    void (*write)(void *context, uint8_t part, uint8_t *bytes); /* into the spare one; then `bytes` is what it holds */
    bool (*commit)(void *context); /* takes the spare one into force; false, and nothing changes, for a bad one */
    uint64_t (*find)(void *context, bool first); /* ROM code of the next part on the 1-Wire, 0 for none; takes 15 ms */
} gh_setup;

/* An answer kept for a request that comes twice. */
typedef struct {
    uint8_t request_seq; /* 0: none kept */
    uint8_t kind;
    uint8_t length;
    uint8_t body[GH_ANSWER_SIZE];
} gh_answer;

typedef struct {
    gh_board_config config;
    gh_safety safety;
    gh_frame_decoder decoder;
    gh_sample samples[GH_SIGNAL_COUNT];
    gh_answer answer;
    const gh_setup *setup; /* NULL: the board cannot be configured */
    uint32_t report_ms; /* multiple of the report period that was passed last */
    uint32_t boot_count;
    uint16_t not_for_us; /* whole frames dropped: looped back or without seq */
    uint16_t waiting;    /* bytes in transmit */
    uint8_t reset_cause;
    uint8_t seq;
    uint8_t echoed_off_cause, echoed_trip_cause;
    bool echo_due;
    bool has_air_pair;
    gh_air_pair air_pair;
    bool restart; /* a new configuration is in force: send what waits, then reset */
    uint8_t transmit[GH_TRANSMIT_SIZE];
} gh_board;

/* For a caller that cannot see the structure (a binding). */
size_t gh_board_size(void);

/* All outputs safe, an unasked hello waiting. `persistent`: GH_PERSISTENT_SIZE bytes as gh_board_persistent gave
 * them before the reset, all 0xFF when blank. `boot_count` counts this start already. A number of the configuration
 * outside its range in hello is taken as the nearest inside, a zero too, and hello tells the one taken. */
void gh_board_init(gh_board *board, const gh_board_config *wanted, const uint8_t *persistent, uint8_t reset_cause,
                   uint32_t boot_count);

/* From now on the board can be configured, if its capabilities say so. `setup` is kept by the caller. */
void gh_board_use_setup(gh_board *board, const gh_setup *setup);

/* One byte from the line. */
void gh_board_receive(gh_board *board, uint8_t byte, uint32_t now_ms);

/* A new sample: raw integer in the unit of its signal or GH_NO_VALUE, and GH_QUALITY_... */
void gh_board_sample(gh_board *board, gh_signal signal, int32_t raw, uint8_t quality, uint32_t now_ms);

/* What two air sensors show, GH_NO_VALUE for one that does not, and GH_AIR_VERDICT_...; told after each report. */
void gh_board_sample_pair(gh_board *board, int32_t first, int32_t second, uint8_t verdict);

/* What the pins must show from now on. Call it at least every 100 ms. */
gh_pins gh_board_step(gh_board *board, uint32_t now_ms);

/* Moves at most `size` waiting bytes to `out` and returns how many. A frame that finds no room is dropped whole. */
size_t gh_board_transmit(gh_board *board, uint8_t *out, size_t size);

/* What must survive a reset: write it to EEPROM when it changes. */
void gh_board_persistent(const gh_board *board, uint8_t *out);

#endif
