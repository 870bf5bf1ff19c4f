#include "gh_ds18b20.h"

#include <string.h>

#include "gh_measure.h"
#include "gh_one_wire.h"

#define PERIOD_MS 1000u
#define CONVERSION_MS 751u /* AC electrical characteristics, tCONV: 750 at 12 bit; 751 ticks are at least that */
#define WRITE_SCRATCHPAD 0x4Eu /* function commands */
#define CONVERT_T 0x44u
#define READ_SCRATCHPAD 0xBEu
#define SCRATCHPAD_BYTES 9u
#define ALARM_HIGH 2u /* places in the scratchpad: memory */
#define ALARM_LOW 3u
#define CONFIG 4u
#define CONFIG_12_BIT 0x7Fu   /* configuration register: 0 R1 R0 1 1 1 1 1 */
#define CONFIG_FIXED 0x9Fu
#define MARK_HIGH 0xA6u       /* alarms that nobody sets: -38 above 89; leaving the factory they are 75 and 70 */
#define MARK_LOW 0x59u
#define POWER_ON_VALUE 0x0550 /* operation, measuring temperature: 85.00 degC */
#define SIXTEENTHS_MIN (-55 * 16)
#define SIXTEENTHS_MAX (125 * 16)
#define FAILURES_MAX 2u /* tries to read one conversion: a disturbed transfer does not change the scratchpad */

void gh_ds18b20_init(gh_ds18b20 *s, const gh_one_wire *wire, const uint64_t *ids, uint8_t count)
{
    memset(s, 0, sizeof *s);
    s->wire = wire;
    s->ids = ids;
    s->count = count < GH_DS18B20_MAX ? count : GH_DS18B20_MAX;
    s->state = GH_DS18B20_MARK;
}

static void enter(gh_ds18b20 *s, gh_ds18b20_state state)
{
    s->state = (uint8_t)state;
    s->position = 0;
}

/* Number of bytes to write in this state, and the one at `place`. */
static uint8_t bytes_out(const gh_ds18b20 *s)
{
    if (s->state == GH_DS18B20_MARK) {
        return 5;
    }
    return s->state == GH_DS18B20_CONVERT || s->ids[s->part] == 0 ? 2 : 10;
}

static uint8_t byte_out(const gh_ds18b20 *s, uint8_t place)
{
    static const uint8_t mark[] = {GH_ONE_WIRE_SKIP_ROM, WRITE_SCRATCHPAD, MARK_HIGH, MARK_LOW, CONFIG_12_BIT};
    if (s->state == GH_DS18B20_MARK) {
        return mark[place];
    }
    if (place == bytes_out(s) - 1) {
        return s->state == GH_DS18B20_CONVERT ? CONVERT_T : READ_SCRATCHPAD;
    }
    if (bytes_out(s) == 2) {
        return GH_ONE_WIRE_SKIP_ROM;
    }
    if (place == 0) {
        return GH_ONE_WIRE_MATCH_ROM;
    }
    return (uint8_t)((s->ids[s->part] >> (8 * (place - 1))) & 0xFFu);
}

typedef enum { TRANSFER_RUNS, TRANSFER_ENDED, TRANSFER_FAILED } transfer_result;

/* The next piece of this state's transfer: the reset, or two bytes. */
static transfer_result transfer(gh_ds18b20 *s)
{
    uint8_t out = bytes_out(s);
    uint8_t all = (uint8_t)(out + (s->state == GH_DS18B20_READ ? SCRATCHPAD_BYTES : 0));
    if (s->position == 0) {
        s->position = 1;
        return s->wire->reset(s->wire->context) == GH_BUS_OK ? TRANSFER_RUNS : TRANSFER_FAILED;
    }
    for (uint8_t i = 0; i < GH_ONE_WIRE_STEP_BYTES && s->position <= all; i++) {
        uint8_t place = (uint8_t)(s->position - 1);
        if (place < out) {
            gh_one_wire_write(s->wire, byte_out(s, place));
        } else {
            s->scratchpad[place - out] = gh_one_wire_read(s->wire);
        }
        s->position++;
    }
    return s->position > all ? TRANSFER_ENDED : TRANSFER_RUNS;
}

/* The right CRC, and the bits of the configuration that are fixed. A bus that is stuck low sends nine zeros, whose CRC
 * is right; a DS18S20 has other bits there. */
static bool is_scratchpad(const uint8_t *scratchpad)
{
    return gh_one_wire_crc8(scratchpad, SCRATCHPAD_BYTES) == 0 &&
           (scratchpad[CONFIG] & CONFIG_FIXED) == (CONFIG_12_BIT & CONFIG_FIXED);
}

/* In 1/16 degC. At a lower resolution the lowest bits are undefined. */
static int16_t sixteenths(const uint8_t *scratchpad)
{
    uint8_t undefined = (uint8_t)(7u >> ((scratchpad[CONFIG] >> 5) & 3u));
    uint16_t word = (uint16_t)((scratchpad[1] << 8) | (scratchpad[0] & ~undefined & 0xFF));
    return (int16_t)(word >= 0x8000u ? (int32_t)word - 0x10000 : (int32_t)word);
}

/* 85.00 degC is what the register holds after power-on. That a part lost its power is seen by its alarm registers: they
 * are then what its EEPROM holds, not the mark. So 85.00 is believed only of a part that has told another value since
 * and still holds the mark: its power-on value was overwritten by a conversion. (The reserved byte 6 is said to tell
 * the same, but no datasheet promises it.) When one part has lost its mark, all are marked anew, and none is believed:
 * another one may have lost it in between. A part that cannot hold the mark is only ever doubted at 85.00. */
static gh_measurement temperature_from(gh_ds18b20 *s)
{
    const uint8_t *scratchpad = s->scratchpad;
    uint8_t bit = (uint8_t)(1u << s->part);
    int32_t value = sixteenths(scratchpad);
    if (scratchpad[ALARM_HIGH] != MARK_HIGH || scratchpad[ALARM_LOW] != MARK_LOW ||
        scratchpad[CONFIG] != CONFIG_12_BIT) {
        s->marked = false;
        s->overwritten = 0;
    } else if (value != POWER_ON_VALUE && s->marked) {
        s->overwritten |= bit;
    }
    if (value == POWER_ON_VALUE && (s->overwritten & bit) == 0) {
        return gh_bad(GH_QUALITY_FAULT);
    }
    if (value < SIXTEENTHS_MIN || value > SIXTEENTHS_MAX) {
        return gh_bad(GH_QUALITY_RANGE);
    }
    return gh_good((value * 25 + (value < 0 ? -2 : 2)) / 4);
}

static bool tell(gh_ds18b20 *s, gh_measurement measurement, uint8_t *part, gh_measurement *temperature)
{
    *part = s->part++;
    *temperature = measurement;
    s->failures = 0;
    s->position = 0;
    return true;
}

/* Returns true with the measurement of one part, or that none was made. */
static bool read(gh_ds18b20 *s, uint8_t *part, gh_measurement *temperature)
{
    if (!s->converted) {
        return tell(s, gh_bad(GH_QUALITY_FAULT), part, temperature);
    }
    transfer_result result = transfer(s);
    if (result == TRANSFER_RUNS) {
        return false;
    }
    if (result == TRANSFER_ENDED && is_scratchpad(s->scratchpad)) {
        return tell(s, temperature_from(s), part, temperature);
    }
    if (++s->failures < FAILURES_MAX) {
        s->position = 0;
        return false;
    }
    return tell(s, gh_bad(GH_QUALITY_FAULT), part, temperature);
}

/* Marks the parts if needed, and has all of them convert. */
static void start_cycle(gh_ds18b20 *s, uint32_t now_ms)
{
    transfer_result result = transfer(s);
    if (result == TRANSFER_RUNS) {
        return;
    }
    if (s->state == GH_DS18B20_MARK && result == TRANSFER_ENDED) {
        s->marked = true;
        enter(s, GH_DS18B20_CONVERT);
        return;
    }
    s->converted = result == TRANSFER_ENDED;
    s->part = 0;
    s->start_ms = now_ms;
    enter(s, s->converted ? GH_DS18B20_WAIT : GH_DS18B20_READ);
}

bool gh_ds18b20_step(gh_ds18b20 *s, uint32_t now_ms, uint8_t *part, gh_measurement *temperature)
{
    if (s->count == 0) {
        return false;
    }
    switch ((gh_ds18b20_state)s->state) {
    case GH_DS18B20_MARK:
    case GH_DS18B20_CONVERT:
        start_cycle(s, now_ms);
        return false;
    case GH_DS18B20_WAIT:
        if (s->position == 0) { /* `now_ms` may be as old as one round of the loop: not when the command ended */
            s->position = 1;
            s->start_ms = now_ms;
        }
        if (now_ms - s->start_ms >= CONVERSION_MS) {
            enter(s, GH_DS18B20_READ);
        }
        return false;
    case GH_DS18B20_READ:
        break;
    }
    if (s->part < s->count) {
        return read(s, part, temperature);
    }
    if (now_ms - s->start_ms >= PERIOD_MS) {
        enter(s, s->marked ? GH_DS18B20_CONVERT : GH_DS18B20_MARK);
    }
    return false;
}
