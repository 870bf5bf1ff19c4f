#include "gh_sensirion.h"

#define WORD_SIZE 3u /* with its CRC */

uint8_t gh_crc8_f7(const uint8_t *data, uint8_t size)
{
    uint8_t crc = 0xFF;
    for (uint8_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (uint8_t bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc & 0x80u) != 0 ? (crc << 1) ^ 0x31 : crc << 1);
        }
    }
    return crc;
}

gh_bus_result gh_sensirion_send(const gh_sensirion *sensirion, uint16_t command)
{
    const uint8_t out[] = {(uint8_t)(command >> 8), (uint8_t)(command & 0xFFu)};
    return gh_i2c_part_transfer(&sensirion->part, out, sizeof out, NULL, 0);
}

static gh_words damaged_words(gh_sensirion *sensirion)
{
    if (sensirion->damaged) {
        return GH_WORDS_FAULT;
    }
    sensirion->damaged = true;
    return GH_WORDS_DAMAGED;
}

gh_words gh_sensirion_read(gh_sensirion *sensirion, uint16_t *words, uint8_t count)
{
    uint8_t in[GH_SENSIRION_WORDS * WORD_SIZE];
    if (gh_i2c_part_transfer(&sensirion->part, NULL, 0, in, (uint8_t)(count * WORD_SIZE)) != GH_BUS_OK) {
        return GH_WORDS_FAULT;
    }
    for (uint8_t i = 0; i < count; i++) {
        const uint8_t *word = in + i * WORD_SIZE;
        if (gh_crc8_f7(word, 2) != word[2]) {
            return damaged_words(sensirion);
        }
        words[i] = (uint16_t)((uint16_t)word[0] << 8 | word[1]);
    }
    return GH_WORDS_RIGHT;
}

gh_measurement gh_sensirion_fault(gh_sensirion *sensirion)
{
    sensirion->damaged = false;
    return gh_i2c_part_fault(&sensirion->part);
}
