/* What the EEPROM holds: trips and stops, the count of starts, two blocks of configuration and which is in force. */
#ifndef GH_EEPROM_H
#define GH_EEPROM_H

#include "gh_board.h"
#include "gh_config.h"

void gh_eeprom_read_latches(uint8_t *latches);
void gh_eeprom_keep_latches(const uint8_t *latches); /* 3.4 ms for each byte that differs */
uint32_t gh_eeprom_count_start(void);

/* The configuration in force; false, and `config` has no pin and no part, where there is none. */
bool gh_eeprom_config(gh_config *config);

/* For gh_setup. */
void gh_eeprom_read_part(void *context, uint8_t part, uint8_t *bytes);
void gh_eeprom_write_part(void *context, uint8_t part, uint8_t *bytes);
bool gh_eeprom_commit(void *context);

#endif
