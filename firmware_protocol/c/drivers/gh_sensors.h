/* All sensors of a board, made from its configuration: which driver reads what, and whose turn it is. */
#ifndef GH_SENSORS_H
#define GH_SENSORS_H

#include "gh_bh1750.h"
#include "gh_config.h"
#include "gh_dht22.h"
#include "gh_ds18b20.h"
#include "gh_float.h"
#include "gh_hcsr04.h"
#include "gh_scd4x.h"
#include "gh_sht.h"
#include "gh_soil.h"
#include "gh_vote.h"

/* Kept by the caller, with everything behind their contexts, as long as the sensors live. */
typedef struct {
    gh_i2c i2c;
    gh_one_wire wire;
    gh_lines lines;
} gh_buses;

/* One part and its driver. A DS18B20 has none of its own: one driver reads all of them. */
typedef struct {
    uint8_t kind; /* gh_part_kind */
    bool outside;
    uint8_t place; /* of a DS18B20 among its kind; of an air sensor in the vote */
    union {
        gh_sht sht;
        gh_scd4x scd4x;
        gh_bh1750 bh1750;
        gh_dht22 dht22;
        gh_soil soil;
        gh_hcsr04 hcsr04;
        gh_float float_switch;
    } driver;
} gh_sensor;

typedef struct {
    const gh_buses *buses;
    gh_sensor sensors[GH_PARTS_MAX];
    uint64_t ids[GH_PARTS_MAX]; /* ROM codes of the DS18B20 */
    gh_ds18b20 ds18b20;
    gh_vote vote;
    gh_measurement co2; /* the last one: it comes every 5 s, and a sample is stale after 3 */
    uint32_t co2_ms, co2_told_ms;
    int32_t air; /* 0.01 degC, GH_NO_VALUE when not known: sound is faster in warm air */
    uint8_t count, ds18b20_count, air_count;
    uint8_t turn;
    uint8_t humidity_part; /* whose humidity is told */
    bool co2_known;
    bool listening; /* a driver times edges on the lines: nothing may keep interrupts off */
} gh_sensors;

/* `config` as gh_config_read gave it. Nothing is read yet. */
void gh_sensors_init(gh_sensors *s, const gh_config *config, const gh_buses *buses, uint32_t now_ms);

/* One driver's step, at most 2 ms on a bus; what it found goes to the board. Call it every round of the loop. */
void gh_sensors_step(gh_sensors *s, gh_board *board, uint32_t now_ms);

/* GH_CAPABILITY_... of what is configured: outputs and sensors. */
uint16_t gh_config_capabilities(const gh_config *config);

#endif
