#include "gh_sensors.h"

#include <string.h>

#include "gh_measure.h"
#include "gh_one_wire.h"

#define DS18B20_FAMILY 0x28u
#define CO2_REPEAT_MS 1000u
#define CO2_KEEP_MS 8000u /* above the 5 s between two values, and a late poll */
#define NO_PART 0xFFu

static bool measures_air(const gh_part *part)
{
    return gh_part_signal(part) == GH_SIGNAL_TEMP_AIR;
}

static bool measures_humidity(const gh_part *part)
{
    return measures_air(part) && part->kind != GH_PART_DS18B20;
}

static uint64_t rom_code(const uint8_t *serial)
{
    uint8_t bytes[8] = {DS18B20_FAMILY};
    uint64_t code = 0;
    memcpy(bytes + 1, serial, 6);
    bytes[7] = gh_one_wire_crc8(bytes, 7);
    for (uint8_t i = 8; i > 0; i--) {
        code = code << 8 | bytes[i - 1];
    }
    return code;
}

static void start_driver(gh_sensors *s, gh_sensor *sensor, const gh_part *part, uint32_t now_ms)
{
    const gh_buses *buses = s->buses;
    switch (part->kind) {
    case GH_PART_SHT3X:
    case GH_PART_SHT4X:
        gh_sht_init(&sensor->driver.sht, &buses->i2c, part->kind == GH_PART_SHT3X ? GH_SHT3X : GH_SHT4X, part->pin);
        break;
    case GH_PART_DHT22:
        gh_dht22_init(&sensor->driver.dht22, &buses->lines, &s->listening, part->pin, now_ms);
        break;
    case GH_PART_DS18B20:
        s->ids[s->ds18b20_count] = gh_part_has_serial(part) ? rom_code(part->serial) : 0;
        s->ds18b20_count++;
        break;
    case GH_PART_SCD4X:
        gh_scd4x_init(&sensor->driver.scd4x, &buses->i2c);
        break;
    case GH_PART_BH1750:
        gh_bh1750_init(&sensor->driver.bh1750, &buses->i2c, part->pin, (uint16_t)(part->first * 10)); /* 10 lux */
        break;
    case GH_PART_SOIL:
        gh_soil_init(&sensor->driver.soil, &buses->lines, part->pin, (uint16_t)part->first, (uint16_t)part->last);
        break;
    case GH_PART_HCSR04:
        gh_hcsr04_init(&sensor->driver.hcsr04, &buses->lines, &s->listening, part->pin, part->second,
                       (uint16_t)part->first, (uint16_t)part->last);
        break;
    default:
        gh_float_init(&sensor->driver.float_switch, &buses->lines, part->pin, part->first != 0);
        break;
    }
}

void gh_sensors_init(gh_sensors *s, const gh_config *config, const gh_buses *buses, uint32_t now_ms)
{
    memset(s, 0, sizeof *s);
    s->buses = buses;
    s->air = GH_NO_VALUE;
    s->humidity_part = NO_PART;
    s->count = config->part_count;
    for (uint8_t i = 0; i < s->count; i++) {
        const gh_part *part = &config->parts[i];
        gh_sensor *sensor = &s->sensors[i];
        sensor->kind = part->kind;
        sensor->outside = part->outside;
        sensor->place = measures_air(part) ? s->air_count++ : 0;
        if (s->humidity_part == NO_PART && measures_humidity(part)) {
            s->humidity_part = i;
        }
        start_driver(s, sensor, part, now_ms);
    }
    gh_vote_init(&s->vote, config->air_apart);
    gh_ds18b20_init(&s->ds18b20, &buses->wire, s->ids, s->ds18b20_count);
}

static void tell(gh_board *board, gh_signal signal, const gh_measurement *found, uint32_t now_ms)
{
    gh_board_sample(board, signal, found->raw, found->quality, now_ms);
}

static void tell_temperature(gh_sensors *s, const gh_sensor *sensor, gh_board *board, const gh_measurement *found,
                             uint32_t now_ms)
{
    if (sensor->outside) {
        tell(board, GH_SIGNAL_TEMP_AMBIENT, found, now_ms);
    } else if (s->air_count > 1) {
        gh_vote_hear(&s->vote, sensor->place, found, now_ms);
    } else {
        s->air = found->raw;
        tell(board, GH_SIGNAL_TEMP_AIR, found, now_ms);
    }
}

static int32_t shown_by(const gh_vote_sensor *sensor)
{
    return sensor->good ? sensor->raw : GH_NO_VALUE;
}

static void tell_pair(const gh_sensors *s, gh_board *board, uint8_t verdict)
{
    const gh_vote_sensor *both = s->vote.sensors;
    gh_board_sample_pair(board, shown_by(&both[0]), shown_by(&both[1]), verdict);
}

static void step_vote(gh_sensors *s, gh_board *board, uint32_t now_ms)
{
    gh_measurement found;
    uint8_t verdict;
    if (s->air_count > 1 && gh_vote_step(&s->vote, now_ms, &found, &verdict)) {
        tell_pair(s, board, verdict);
        s->air = found.raw;
        tell(board, GH_SIGNAL_TEMP_AIR, &found, now_ms);
    }
}

/* The DS18B20 with this place among its kind. */
static const gh_sensor *ds18b20_at(const gh_sensors *s, uint8_t place)
{
    for (uint8_t i = 0; i < s->count; i++) {
        if (s->sensors[i].kind == GH_PART_DS18B20 && place-- == 0) {
            return &s->sensors[i];
        }
    }
    return &s->sensors[0];
}

static void step_wire(gh_sensors *s, gh_board *board, uint32_t now_ms)
{
    uint8_t place;
    gh_measurement found;
    if (s->ds18b20_count > 0 && !s->listening && gh_ds18b20_step(&s->ds18b20, now_ms, &place, &found)) {
        tell_temperature(s, ds18b20_at(s, place), board, &found, now_ms);
    }
}

static void step_co2(gh_sensors *s, gh_sensor *sensor, gh_board *board, uint32_t now_ms)
{
    if (gh_scd4x_step(&sensor->driver.scd4x, now_ms, &s->co2)) {
        s->co2_known = true;
        s->co2_ms = now_ms;
    } else if (!s->co2_known || now_ms - s->co2_told_ms < CO2_REPEAT_MS) {
        return;
    }
    if (now_ms - s->co2_ms > CO2_KEEP_MS) { /* the driver is silent: let the board call it stale */
        s->co2_known = false;
        return;
    }
    s->co2_told_ms = now_ms;
    tell(board, GH_SIGNAL_CO2, &s->co2, now_ms);
}

static void step_air_part(gh_sensors *s, uint8_t number, gh_board *board, uint32_t now_ms)
{
    gh_sensor *sensor = &s->sensors[number];
    gh_measurement temp, humidity;
    bool is_new = sensor->kind == GH_PART_DHT22 ? gh_dht22_step(&sensor->driver.dht22, now_ms, &temp, &humidity)
                                                : gh_sht_step(&sensor->driver.sht, now_ms, &temp, &humidity);
    if (!is_new) {
        return;
    }
    tell_temperature(s, sensor, board, &temp, now_ms);
    if (number == s->humidity_part) {
        tell(board, GH_SIGNAL_REL_HUMIDITY, &humidity, now_ms);
    }
}

static void step_part(gh_sensors *s, uint8_t number, gh_board *board, uint32_t now_ms)
{
    gh_sensor *sensor = &s->sensors[number];
    gh_measurement found;
    switch (sensor->kind) {
    case GH_PART_SHT3X:
    case GH_PART_SHT4X:
    case GH_PART_DHT22:
        step_air_part(s, number, board, now_ms);
        break;
    case GH_PART_SCD4X:
        step_co2(s, sensor, board, now_ms);
        break;
    case GH_PART_BH1750:
        if (gh_bh1750_step(&sensor->driver.bh1750, now_ms, &found)) {
            tell(board, GH_SIGNAL_LIGHT, &found, now_ms);
        }
        break;
    case GH_PART_SOIL:
        if (gh_soil_step(&sensor->driver.soil, now_ms, &found)) {
            tell(board, GH_SIGNAL_SOIL_MOISTURE, &found, now_ms);
        }
        break;
    case GH_PART_HCSR04:
        if (gh_hcsr04_step(&sensor->driver.hcsr04, now_ms, s->air, &found)) {
            tell(board, GH_SIGNAL_TANK_LEVEL, &found, now_ms);
        }
        break;
    case GH_PART_FLOAT:
        if (gh_float_step(&sensor->driver.float_switch, now_ms, &found)) {
            tell(board, GH_SIGNAL_TANK_LEVEL, &found, now_ms);
        }
        break;
    default: /* a DS18B20 has its turn with all others of its kind */
        break;
    }
}

void gh_sensors_step(gh_sensors *s, gh_board *board, uint32_t now_ms)
{
    if (s->turn < s->count) {
        step_part(s, s->turn, board, now_ms);
        s->turn++;
        return;
    }
    s->turn = 0;
    step_vote(s, board, now_ms);
    step_wire(s, board, now_ms);
}

/* The capability of a signal; the air temperature needs none. */
static uint16_t capability_of(gh_signal signal)
{
    switch (signal) {
    case GH_SIGNAL_CO2:
        return GH_CAPABILITY_CO2;
    case GH_SIGNAL_LIGHT:
        return GH_CAPABILITY_LIGHT;
    case GH_SIGNAL_SOIL_MOISTURE:
        return GH_CAPABILITY_SOIL_MOISTURE;
    case GH_SIGNAL_TANK_LEVEL:
        return GH_CAPABILITY_TANK_LEVEL;
    case GH_SIGNAL_TEMP_AMBIENT:
        return GH_CAPABILITY_TEMP_AMBIENT;
    default:
        return 0;
    }
}

uint16_t gh_config_capabilities(const gh_config *config)
{
    uint16_t found = 0;
    found |= config->pins[GH_OUTPUT_LED] != GH_NO_PIN ? GH_CAPABILITY_LED : 0;
    found |= config->pins[GH_OUTPUT_VALVE] != GH_NO_PIN ? GH_CAPABILITY_VALVE : 0;
    found |= config->pins[GH_OUTPUT_CUTOFF] != GH_NO_PIN ? GH_CAPABILITY_HEATER_CUTOFF : 0;
    for (uint8_t i = 0; i < config->part_count; i++) {
        const gh_part *part = &config->parts[i];
        found |= capability_of(gh_part_signal(part));
        found |= measures_humidity(part) ? GH_CAPABILITY_HUMIDITY : 0;
    }
    return found;
}
