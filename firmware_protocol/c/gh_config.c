#include "gh_config.h"

#include <string.h>

#define HEAD_SIZE 32u /* CRC included */
#define PART_SIZE 14u
#define LED_MEGA_FIRST 6u /* timer 4: pins 6, 7 and 8 */
#define LED_MEGA_LAST 8u

/* What a pin may serve as. */
typedef enum { AS_DIGITAL, AS_LISTENER, AS_ANALOG, AS_LED } pin_use;

/* Pins that serve already, one bit each. */
typedef struct {
    uint8_t bits[9]; /* 70 pins */
} pin_set;

static uint16_t u16_at(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)at[1] << 8);
}

static int16_t i16_at(const uint8_t *at)
{
    return (int16_t)u16_at(at);
}

static uint64_t u64_at(const uint8_t *at)
{
    uint64_t value = 0;
    for (uint8_t i = 8; i > 0; i--) {
        value = value << 8 | at[i - 1];
    }
    return value;
}

static bool within(int32_t value, int32_t low, int32_t high)
{
    return low <= value && value <= high;
}

static bool mega_serves(uint8_t pin, pin_use use)
{
    if (!within(pin, 2, 69) || pin == 20 || pin == 21) { /* 0, 1: the host's line; 20, 21: I2C */
        return false;
    }
    switch (use) {
    case AS_LISTENER: /* pin change interrupts 0..7 and 16..23 */
        return within(pin, 10, 13) || within(pin, 50, 53) || within(pin, 62, 69);
    case AS_ANALOG:
        return pin >= 54;
    case AS_LED:
        return within(pin, LED_MEGA_FIRST, LED_MEGA_LAST);
    default:
        return true;
    }
}

static bool uno_serves(uint8_t pin, pin_use use)
{
    if (!within(pin, 2, 17)) { /* 0, 1: the host's line; 18, 19 are A4, A5: I2C */
        return false;
    }
    switch (use) {
    case AS_ANALOG:
        return pin >= 14;
    case AS_LED:
        return pin == 3 || pin == 11; /* timer 2 */
    default:
        return true;
    }
}

/* Takes a pin for one use; false where it cannot serve or serves already. */
static bool take(pin_set *used, gh_board_kind kind, uint8_t pin, pin_use use)
{
    if (!(kind == GH_MEGA2560 ? mega_serves(pin, use) : uno_serves(pin, use))) {
        return false;
    }
    uint8_t bit = (uint8_t)(1u << (pin & 7u));
    if (used->bits[pin >> 3] & bit) {
        return false;
    }
    used->bits[pin >> 3] |= bit;
    return true;
}

static bool is_i2c(uint8_t kind)
{
    return kind == GH_PART_SHT3X || kind == GH_PART_SHT4X || kind == GH_PART_SCD4X || kind == GH_PART_BH1750;
}

static bool has_address(const gh_part *part)
{
    switch (part->kind) {
    case GH_PART_SHT3X:
        return part->pin == 0x44 || part->pin == 0x45;
    case GH_PART_SHT4X:
        return within(part->pin, 0x44, 0x46);
    case GH_PART_SCD4X:
        return part->pin == 0x62;
    default:
        return part->pin == 0x23 || part->pin == 0x5C;
    }
}

bool gh_part_has_serial(const gh_part *part)
{
    static const uint8_t none[sizeof part->serial] = {0};
    return memcmp(part->serial, none, sizeof none) != 0;
}

static bool numbers_suit(const gh_part *part)
{
    if ((part->second != GH_NO_PIN) != (part->kind == GH_PART_HCSR04)) {
        return false;
    }
    int32_t first = part->first, last = part->last, apart = first > last ? first - last : last - first;
    switch (part->kind) {
    case GH_PART_SOIL:
        return within(first, 4, 1019) && within(last, 4, 1019) && apart >= 20;
    case GH_PART_HCSR04:
        return within(first, 20, 4000) && within(last, 20, 4000) && first - last >= 10;
    case GH_PART_BH1750:
        return within(first, 1, 5461) && last == 0; /* 65535 counts are 54 612 lux */
    case GH_PART_FLOAT:
        return within(first, 0, 1) && last == 0;
    default:
        return first == 0 && last == 0;
    }
}

/* Several DS18B20 hang on one wire, each with a serial number of its own. */
static bool joins_the_wire(const gh_config *config, const gh_part *part, bool *is_first)
{
    *is_first = true;
    for (uint8_t i = 0; i < config->part_count; i++) {
        const gh_part *other = &config->parts[i];
        if (other->kind != GH_PART_DS18B20) {
            continue;
        }
        *is_first = false;
        if (other->pin != part->pin || !gh_part_has_serial(other) || !gh_part_has_serial(part) ||
            memcmp(other->serial, part->serial, sizeof part->serial) == 0) {
            return false;
        }
    }
    return true;
}

static bool takes_pins(const gh_config *config, gh_board_kind kind, const gh_part *part, pin_set *used)
{
    bool is_first;
    switch (part->kind) {
    case GH_PART_DS18B20:
        return joins_the_wire(config, part, &is_first) && (!is_first || take(used, kind, part->pin, AS_DIGITAL));
    case GH_PART_HCSR04:
        return take(used, kind, part->pin, AS_DIGITAL) && take(used, kind, part->second, AS_LISTENER);
    case GH_PART_SOIL:
        return take(used, kind, part->pin, AS_ANALOG);
    case GH_PART_DHT22:
        return take(used, kind, part->pin, AS_LISTENER);
    default:
        return take(used, kind, part->pin, AS_DIGITAL);
    }
}

static bool address_is_free(const gh_config *config, const gh_part *part)
{
    for (uint8_t i = 0; i < config->part_count; i++) {
        if (is_i2c(config->parts[i].kind) && config->parts[i].pin == part->pin) {
            return false;
        }
    }
    return true;
}

gh_signal gh_part_signal(const gh_part *part)
{
    switch (part->kind) {
    case GH_PART_SCD4X:
        return GH_SIGNAL_CO2;
    case GH_PART_BH1750:
        return GH_SIGNAL_LIGHT;
    case GH_PART_SOIL:
        return GH_SIGNAL_SOIL_MOISTURE;
    case GH_PART_HCSR04:
    case GH_PART_FLOAT:
        return GH_SIGNAL_TANK_LEVEL;
    default:
        return part->outside ? GH_SIGNAL_TEMP_AMBIENT : GH_SIGNAL_TEMP_AIR;
    }
}

/* Two air sensors are compared; of more parts for one signal nobody knows what to do. */
static bool signal_is_free(const gh_config *config, const gh_part *part)
{
    gh_signal signal = gh_part_signal(part);
    uint8_t others = 0;
    for (uint8_t i = 0; i < config->part_count; i++) {
        others = (uint8_t)(others + (gh_part_signal(&config->parts[i]) == signal ? 1 : 0));
    }
    return others < (signal == GH_SIGNAL_TEMP_AIR ? 2 : 1);
}

static bool part_suits(const gh_config *config, gh_board_kind kind, const gh_part *part, pin_set *used)
{
    bool has_place = part->kind <= GH_PART_DS18B20; /* inside or outside */
    if ((part->outside && !has_place) || (gh_part_has_serial(part) && part->kind != GH_PART_DS18B20) || !numbers_suit(part) ||
        !signal_is_free(config, part)) {
        return false;
    }
    if (is_i2c(part->kind)) {
        return has_address(part) && address_is_free(config, part);
    }
    return takes_pins(config, kind, part, used);
}

static bool read_part(const uint8_t *at, gh_part *part)
{
    part->kind = at[0];
    part->outside = at[1] != 0;
    part->pin = at[2];
    part->second = at[3];
    part->first = i16_at(at + 4);
    part->last = i16_at(at + 6);
    memcpy(part->serial, at + 8, sizeof part->serial);
    return within(part->kind, GH_PART_SHT3X, GH_PART_FLOAT) && at[1] <= 1;
}

static bool read_limits(const uint8_t *block, gh_config *config)
{
    gh_board_config *board = &config->board;
    board->board_id = u64_at(block + 4);
    board->lease_max_ms = u16_at(block + 12);
    board->temp_trip = i16_at(block + 14);
    board->valve_pulse_max_ds = u16_at(block + 16);
    board->pwm_window_ds = u16_at(block + 18);
    board->report_period_ms = u16_at(block + 20);
    board->fan_safe_on = (block[22] & 1u) != 0;
    config->inverted = (uint8_t)(block[22] >> 1);
    config->air_apart = u16_at(block + 28);
    return board->board_id != 0 && within(board->lease_max_ms, 100, 60000) && within(board->temp_trip, 0, 10000) &&
           within(board->valve_pulse_max_ds, 0, 600) && within(board->pwm_window_ds, 10, 6000) &&
           within(board->report_period_ms, 100, 60000) && within(config->air_apart, 10, 1000) && block[22] < 64;
}

static bool read_outputs(const uint8_t *block, gh_board_kind kind, gh_config *config, pin_set *used)
{
    for (uint8_t i = 0; i < GH_OUTPUTS; i++) {
        uint8_t pin = config->pins[i] = block[23 + i];
        if (pin != GH_NO_PIN && !take(used, kind, pin, i == GH_OUTPUT_LED ? AS_LED : AS_DIGITAL)) {
            return false;
        }
    }
    return true;
}

bool gh_config_read(const uint8_t *block, gh_board_kind kind, gh_config *config)
{
    pin_set used = {{0}};
    uint8_t count = block[30];
    memset(config, 0, sizeof *config);
    if (gh_crc16(block + 2, GH_BLOCK_SIZE - 2) != u16_at(block) || block[2] != GH_BLOCK_LAYOUT || block[3] != kind ||
        count > GH_PARTS_MAX || block[31] != 0 || !read_limits(block, config) ||
        !read_outputs(block, kind, config, &used)) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++) {
        gh_part *part = &config->parts[i];
        if (!read_part(block + HEAD_SIZE + i * PART_SIZE, part) || !part_suits(config, kind, part, &used)) {
            return false;
        }
        config->part_count++;
    }
    for (uint8_t i = (uint8_t)(HEAD_SIZE + count * PART_SIZE); i < GH_BLOCK_SIZE; i++) {
        if (block[i] != 0) {
            return false;
        }
    }
    return true;
}
