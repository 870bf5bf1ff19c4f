#include "gh_i2c_part.h"

#include <string.h>

void gh_i2c_part_init(gh_i2c_part *part, const gh_i2c *bus, uint8_t address, uint16_t pause_ms)
{
    memset(part, 0, sizeof *part);
    part->bus = bus;
    part->address = address;
    part->pause_ms = pause_ms;
}

bool gh_i2c_part_due(gh_i2c_part *part, uint32_t now_ms)
{
    if (!part->paused) {
        part->paused = true;
        part->since_ms = now_ms;
    }
    return now_ms - part->since_ms >= part->pause_ms; /* unsigned: right across the clock's wrap */
}

void gh_i2c_part_next(gh_i2c_part *part, uint8_t task, uint16_t pause_ms)
{
    part->task = task;
    part->pause_ms = pause_ms;
    part->paused = false;
}

gh_bus_result gh_i2c_part_transfer(const gh_i2c_part *part, const uint8_t *out, uint8_t out_size, uint8_t *in,
                                   uint8_t in_size)
{
    return part->bus->transfer(part->bus->context, part->address, out, out_size, in, in_size);
}

gh_measurement gh_i2c_part_fault(gh_i2c_part *part)
{
    gh_measurement fault = {GH_NO_VALUE, GH_QUALITY_FAULT};
    gh_i2c_part_next(part, 0, GH_I2C_RETRY_MS);
    return fault;
}
