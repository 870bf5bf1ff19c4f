#include "gh_scd4x.h"

#define ADDRESS 0x62u /* SCD4x datasheet v1.4: "Digital Interface Description", I2C device address */

/* SCD4x datasheet v1.4: "SCD4x Command Overview". */
#define STOP_PERIODIC_MEASUREMENT 0x3F86u
#define START_PERIODIC_MEASUREMENT 0x21B1u
#define GET_DATA_READY_STATUS 0xE4B8u
#define READ_MEASUREMENT 0xEC05u

/* Pauses [ms]: the longest time of the datasheet, rounded up, and one, see gh_i2c_part_next. */
#define POWER_UP_MS 1001u /* SCD4x datasheet v1.4: "Power-Up and Communication Start", 1000 ms */
#define STOPPING_MS 501u  /* SCD4x datasheet v1.4: "stop_periodic_measurement", 500 ms */
#define EXECUTION_MS 2u   /* SCD4x datasheet v1.4: "SCD4x Command Overview", 1 ms for both commands that read */
#define POLL_MS 500u      /* a value is at most that old; the part measures every 5 s */
#define POLLS_MAX 16u     /* 8 s: a part that lost its power acknowledges, but is never ready */

/* SCD4x datasheet v1.4: "get_data_ready_status": the lowest 11 bits are 0 while nothing is ready. */
#define READY_BITS 0x07FFu
/* The part gives up to 40000 ppm (SCD4x datasheet v1.4: "CO2 Sensing Performance"), the signal less. */
#define CO2_MAX GH_SENSOR_REPORT_CO2_PPM_MAX

enum { STOP, START, ASK, READ_STATUS, FETCH, READ };

void gh_scd4x_init(gh_scd4x *scd4x, const gh_i2c *bus)
{
    gh_i2c_part_init(&scd4x->sensirion.part, bus, ADDRESS, POWER_UP_MS);
    scd4x->sensirion.damaged = false;
    scd4x->polls = 0;
}

/* Sends a command, and goes to the next task after the pause. */
static gh_bus_result send(gh_scd4x *scd4x, uint16_t command, uint8_t next, uint16_t pause_ms)
{
    gh_i2c_part_next(&scd4x->sensirion.part, next, pause_ms);
    return gh_sensirion_send(&scd4x->sensirion, command);
}

/* A part that measures refuses the start: it is stopped first, for a reset of the board may have left it measuring. One
 * that is idle may refuse the stop, so that silence is no fault yet. */
static bool stop(gh_scd4x *scd4x)
{
    gh_bus_result result = send(scd4x, STOP_PERIODIC_MEASUREMENT, START, STOPPING_MS);
    return result == GH_BUS_OK || result == GH_BUS_SILENT;
}

static bool start(gh_scd4x *scd4x)
{
    scd4x->polls = 0;
    return send(scd4x, START_PERIODIC_MEASUREMENT, ASK, POLL_MS) == GH_BUS_OK;
}

/* False: a fault. A status whose CRC is wrong says nothing, and is asked for again. */
static bool read_status(gh_scd4x *scd4x)
{
    uint16_t status = 0;
    gh_words words = gh_sensirion_read(&scd4x->sensirion, &status, 1);
    bool ready = words == GH_WORDS_RIGHT && (status & READY_BITS) != 0;
    gh_i2c_part_next(&scd4x->sensirion.part, ready ? FETCH : ASK, ready ? 0 : POLL_MS);
    scd4x->polls++;
    return words != GH_WORDS_FAULT && (ready || scd4x->polls < POLLS_MAX);
}

static bool report_fault(gh_scd4x *scd4x, gh_measurement *co2)
{
    *co2 = gh_sensirion_fault(&scd4x->sensirion);
    return true;
}

/* The part gives a measurement once: after a wrong CRC the next one, 5 s later, is the second attempt. */
static bool read_measurement(gh_scd4x *scd4x, gh_measurement *co2)
{
    uint16_t words[3]; /* CO2, temperature, humidity */
    gh_words result = gh_sensirion_read(&scd4x->sensirion, words, 3);
    if (result == GH_WORDS_FAULT || (result == GH_WORDS_RIGHT && words[0] == 0)) { /* 0 ppm: nothing was measured */
        return report_fault(scd4x, co2);
    }
    scd4x->polls = 0;
    gh_i2c_part_next(&scd4x->sensirion.part, ASK, POLL_MS);
    if (result == GH_WORDS_DAMAGED) {
        return false;
    }
    scd4x->sensirion.damaged = false;
    bool inside = words[0] <= CO2_MAX;
    co2->raw = inside ? words[0] : GH_NO_VALUE;
    co2->quality = inside ? GH_QUALITY_GOOD : GH_QUALITY_RANGE;
    return true;
}

/* Every task but the last, which alone gives a value. False: a fault. */
static bool prepare(gh_scd4x *scd4x)
{
    switch (scd4x->sensirion.part.task) {
    case STOP:
        return stop(scd4x);
    case START:
        return start(scd4x);
    case ASK:
        return send(scd4x, GET_DATA_READY_STATUS, READ_STATUS, EXECUTION_MS) == GH_BUS_OK;
    case READ_STATUS:
        return read_status(scd4x);
    default: /* FETCH */
        return send(scd4x, READ_MEASUREMENT, READ, EXECUTION_MS) == GH_BUS_OK;
    }
}

bool gh_scd4x_step(gh_scd4x *scd4x, uint32_t now_ms, gh_measurement *co2)
{
    if (!gh_i2c_part_due(&scd4x->sensirion.part, now_ms)) {
        return false;
    }
    if (scd4x->sensirion.part.task == READ) {
        return read_measurement(scd4x, co2);
    }
    return !prepare(scd4x) && report_fault(scd4x, co2);
}
