/* Sensirion SHT3x and SHT4x: temperature and relative humidity, one measurement a second.
 * sizeof(gh_sht) is 13 on an AVR. */
#ifndef GH_SHT_H
#define GH_SHT_H

#include "gh_sensirion.h"

#define GH_SHT_ADDRESS 0x44u      /* SHT3x with ADDR low; SHT4x but for the types -B and -C */
#define GH_SHT3X_ADDRESS_HIGH 0x45u /* SHT3x with ADDR high */

typedef enum { GH_SHT3X, GH_SHT4X } gh_sht_kind;

typedef struct {
    gh_sensirion sensirion;
    uint8_t kind; /* gh_sht_kind */
} gh_sht;

void gh_sht_init(gh_sht *sht, const gh_i2c *bus, gh_sht_kind kind, uint8_t address);

/* Call it every round of the loop. True: both measurements are new, in 0.01 degC and 0.01 %; else they are left alone.
 * RANGE is given to both: outside its temperatures the part is not specified to measure humidity. */
bool gh_sht_step(gh_sht *sht, uint32_t now_ms, gh_measurement *temp, gh_measurement *rel_humidity);

#endif
