/* What Sensirion's parts share: words of 16 bits, high byte first, each followed by its CRC. */
#ifndef GH_SENSIRION_H
#define GH_SENSIRION_H

#include "gh_i2c_part.h"

#define GH_SENSIRION_WORDS 3u /* the longest answer that is read */

typedef enum {
    GH_WORDS_RIGHT,
    GH_WORDS_DAMAGED, /* the first wrong CRC: ask once more */
    GH_WORDS_FAULT    /* nothing was read, or the CRC is wrong again */
} gh_words;

/* 12 bytes on an AVR. */
typedef struct {
    gh_i2c_part part;
    bool damaged; /* a CRC was wrong since the last measurement or fault */
} gh_sensirion;

/* CRC-8/NRSC-5: polynomial 0x31, initial 0xFF, check value 0xF7. SHT3x-DIS datasheet v6, "Checksum Calculation"; SHT4x
 * datasheet v6 and SCD4x datasheet v1.4 describe the same one. */
uint8_t gh_crc8_f7(const uint8_t *data, uint8_t size);

/* Sends a command of 16 bits. */
gh_bus_result gh_sensirion_send(const gh_sensirion *sensirion, uint16_t command);

/* Reads `count` words, at most GH_SENSIRION_WORDS; they are undefined unless RIGHT. */
gh_words gh_sensirion_read(gh_sensirion *sensirion, uint16_t *words, uint8_t count);

/* As gh_i2c_part_fault; the next wrong CRC is a first one again. */
gh_measurement gh_sensirion_fault(gh_sensirion *sensirion);

#endif
