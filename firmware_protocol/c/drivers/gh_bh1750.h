/* ROHM BH1750: light, one measurement a second. sizeof(gh_bh1750) is 13 on an AVR.
 * The part has no checksum: a bit that the line changes is not noticed. */
#ifndef GH_BH1750_H
#define GH_BH1750_H

#include "gh_i2c_part.h"

/* BH1750FVI datasheet rev D: "Slave Address". */
#define GH_BH1750_ADDRESS 0x23u      /* ADDR low */
#define GH_BH1750_ADDRESS_HIGH 0x5Cu /* ADDR high */

typedef struct {
    gh_i2c_part part;
    uint16_t full_lux;
} gh_bh1750;

/* `full_lux`: the illuminance that the signal calls 1, not 0 (taken as 1). More light than that is RANGE, and so is
 * everything from 54612 lux on, where the part saturates. */
void gh_bh1750_init(gh_bh1750 *bh1750, const gh_i2c *bus, uint8_t address, uint16_t full_lux);

/* Call it every round of the loop. True: `light` [0.0001 of full] is new; else it is left alone. */
bool gh_bh1750_step(gh_bh1750 *bh1750, uint32_t now_ms, gh_measurement *light);

#endif
