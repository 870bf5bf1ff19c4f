/* The board's configuration as its EEPROM holds it; ../board_block.py writes it and keeps the same rules. */
#ifndef GH_CONFIG_H
#define GH_CONFIG_H

#include <stdbool.h>
#include <stdint.h>

#include "gh_board.h"

#define GH_BLOCK_SIZE 144u
#define GH_BLOCK_LAYOUT 1u
#define GH_PARTS_MAX 8u
#define GH_NO_PIN 0xFFu

typedef enum { GH_MEGA2560 = 1, GH_UNO = 2 } gh_board_kind;

typedef enum {
    GH_PART_SHT3X = 1,
    GH_PART_SHT4X,
    GH_PART_DHT22,
    GH_PART_DS18B20,
    GH_PART_SCD4X,
    GH_PART_BH1750,
    GH_PART_SOIL,
    GH_PART_HCSR04,
    GH_PART_FLOAT
} gh_part_kind;

typedef enum { GH_OUTPUT_HEATER, GH_OUTPUT_FAN, GH_OUTPUT_VALVE, GH_OUTPUT_CUTOFF, GH_OUTPUT_LED, GH_OUTPUTS } gh_output;

/* The meaning of `first` and `last` stands in board_block.py. */
typedef struct {
    uint8_t kind; /* gh_part_kind */
    bool outside;
    uint8_t pin;    /* or the I2C address */
    uint8_t second; /* echo of an HC-SR04, else GH_NO_PIN */
    int16_t first, last;
    uint8_t serial[6]; /* of a DS18B20, all 0 for the only one */
} gh_part;

typedef struct {
    gh_board_config board; /* firmware version and capabilities are the program's own to set */
    uint8_t pins[GH_OUTPUTS];
    uint8_t inverted; /* bit of each gh_output that is on while its pin is low */
    uint16_t air_apart; /* 0.01 K */
    uint8_t part_count;
    gh_part parts[GH_PARTS_MAX];
} gh_config;

/* The signal that a part is there for; the humidity of an air sensor comes in addition. */
gh_signal gh_part_signal(const gh_part *part);

/* Whether a DS18B20 has a serial number; without one it is the only one on its wire. */
bool gh_part_has_serial(const gh_part *part);

/* Reads a block. False, and `config` is undefined, for one that is blank, damaged, of another layout or
 * microcontroller, or against a rule: then nothing may be driven. */
bool gh_config_read(const uint8_t *block, gh_board_kind kind, gh_config *config);

#endif
