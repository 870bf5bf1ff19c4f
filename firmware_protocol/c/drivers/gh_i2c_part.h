/* One part on an I2C bus: how its driver speaks to it, and how long it leaves it alone between two transfers. */
#ifndef GH_I2C_PART_H
#define GH_I2C_PART_H

#include "gh_bus.h"

/* Pause after a fault. A dead part is reported that often, and one that was plugged in again has powered up. */
#define GH_I2C_RETRY_MS 1000u

/* 11 bytes on an AVR. */
typedef struct {
    const gh_i2c *bus;
    uint32_t since_ms; /* start of the pause, once `paused` */
    uint16_t pause_ms;
    uint8_t address;
    uint8_t task; /* the driver's next transfer; 0 sets the part up */
    bool paused;
} gh_i2c_part;

void gh_i2c_part_init(gh_i2c_part *part, const gh_i2c *bus, uint8_t address, uint16_t pause_ms);

/* True when the pause is over. The first call after a transfer starts the pause: `now_ms` may be as old as one round
 * of the loop, so the transfer itself has no time of its own. */
bool gh_i2c_part_due(gh_i2c_part *part, uint32_t now_ms);

/* The next transfer, and the pause before it. `now_ms` counts whole milliseconds, so that a datasheet's time is rounded
 * up and one is added. */
void gh_i2c_part_next(gh_i2c_part *part, uint8_t task, uint16_t pause_ms);

gh_bus_result gh_i2c_part_transfer(const gh_i2c_part *part, const uint8_t *out, uint8_t out_size, uint8_t *in,
                                   uint8_t in_size);

/* Sets the part up anew after the pause of a fault, and returns what to report. */
gh_measurement gh_i2c_part_fault(gh_i2c_part *part);

#endif
