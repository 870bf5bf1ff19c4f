#include "gh_sht.h"

/* SHT3x-DIS datasheet v6: "Measurement Commands for Single Shot Data Acquisition Mode", clock stretching disabled, high
 * repeatability. The part answers with NACK while it measures. */
#define SHT3X_MEASURE 0x2400u
/* SHT4x datasheet v6: "Command Overview", measure T & RH with high precision. */
#define SHT4X_MEASURE 0xFDu

/* Pauses [ms]: the longest time of the datasheet, rounded up, and one, see gh_i2c_part_next. */
#define SHT3X_MEASURING_MS 17u /* SHT3x-DIS datasheet v6: "Timing Specification", measurement duration, high: 15.5 */
#define SHT4X_MEASURING_MS 10u /* SHT4x datasheet v6: system timing, measurement duration, high: 8.3 */
#define IDLE_MS 2u             /* SHT3x-DIS datasheet v6: 1 ms between two commands; the SHT4x needs none */
#define START_MS 20u           /* power-up takes 1.5 ms; a reset of the board may have left a measurement running */
#define REST_MS 980u           /* so that the values come once a second */

/* Temperature [0.01 degC] and humidity [0.01 %] of a word of 0 and their spans up to a word of 65535.
 * SHT3x-DIS datasheet v6: "Conversion of Signal Output"; SHT4x datasheet v6: "Conversion of Signal Output". */
#define TEMP_LOW (-4500)
#define TEMP_SPAN 17500u
#define SHT3X_HUMIDITY_SPAN 10000u
#define SHT4X_HUMIDITY_LOW (-600)
#define SHT4X_HUMIDITY_SPAN 12500u
#define HUMIDITY_FULL 10000
/* SHT3x-DIS datasheet v6 and SHT4x datasheet v6: specified range of the temperature [0.01 degC]. */
#define TEMP_MIN (-4000)
#define TEMP_MAX 12500

enum { MEASURE, READ };

void gh_sht_init(gh_sht *sht, const gh_i2c *bus, gh_sht_kind kind, uint8_t address)
{
    gh_i2c_part_init(&sht->sensirion.part, bus, address, START_MS);
    sht->sensirion.damaged = false;
    sht->kind = (uint8_t)kind;
}

static bool report_fault(gh_sht *sht, gh_measurement *temp, gh_measurement *rel_humidity)
{
    *temp = gh_sensirion_fault(&sht->sensirion);
    *rel_humidity = *temp;
    return true;
}

static bool start_measuring(gh_sht *sht)
{
    gh_i2c_part *part = &sht->sensirion.part;
    if (sht->kind == GH_SHT3X) {
        gh_i2c_part_next(part, READ, SHT3X_MEASURING_MS);
        return gh_sensirion_send(&sht->sensirion, SHT3X_MEASURE) == GH_BUS_OK;
    }
    const uint8_t command = SHT4X_MEASURE;
    gh_i2c_part_next(part, READ, SHT4X_MEASURING_MS);
    return gh_i2c_part_transfer(part, &command, 1, NULL, 0) == GH_BUS_OK;
}

/* The nearest integer to span * word / 65535. The divisor is odd: nothing lies halfway between two integers. */
static int32_t scale(uint16_t span, uint16_t word)
{
    return (int32_t)(((uint32_t)span * word + UINT16_MAX / 2u) / UINT16_MAX);
}

static int32_t humidity_from(uint8_t kind, uint16_t word)
{
    if (kind == GH_SHT3X) {
        return scale(SHT3X_HUMIDITY_SPAN, word);
    }
    int32_t humidity = SHT4X_HUMIDITY_LOW + scale(SHT4X_HUMIDITY_SPAN, word);
    if (humidity < 0) { /* SHT4x datasheet v6: crop what lies outside 0..100 % */
        return 0;
    }
    return humidity < HUMIDITY_FULL ? humidity : HUMIDITY_FULL;
}

static void report_words(const gh_sht *sht, const uint16_t *words, gh_measurement *temp,
                         gh_measurement *rel_humidity)
{
    temp->raw = TEMP_LOW + scale(TEMP_SPAN, words[0]);
    temp->quality = GH_QUALITY_GOOD;
    rel_humidity->raw = humidity_from(sht->kind, words[1]);
    rel_humidity->quality = GH_QUALITY_GOOD;
    if (temp->raw < TEMP_MIN || temp->raw > TEMP_MAX) {
        temp->raw = GH_NO_VALUE;
        temp->quality = GH_QUALITY_RANGE;
        *rel_humidity = *temp;
    }
}

bool gh_sht_step(gh_sht *sht, uint32_t now_ms, gh_measurement *temp, gh_measurement *rel_humidity)
{
    gh_sensirion *sensirion = &sht->sensirion;
    if (!gh_i2c_part_due(&sensirion->part, now_ms)) {
        return false;
    }
    if (sensirion->part.task == MEASURE) {
        return !start_measuring(sht) && report_fault(sht, temp, rel_humidity);
    }
    uint16_t words[2];
    switch (gh_sensirion_read(sensirion, words, 2)) {
    case GH_WORDS_RIGHT:
        break;
    case GH_WORDS_DAMAGED:
        gh_i2c_part_next(&sensirion->part, MEASURE, IDLE_MS); /* the part gives its words once */
        return false;
    default:
        return report_fault(sht, temp, rel_humidity);
    }
    sensirion->damaged = false;
    gh_i2c_part_next(&sensirion->part, MEASURE, REST_MS);
    report_words(sht, words, temp, rel_humidity);
    return true;
}
