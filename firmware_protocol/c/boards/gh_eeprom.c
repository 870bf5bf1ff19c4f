#include "gh_eeprom.h"

#include <avr/eeprom.h>
#include <string.h>

#include "gh_pins.h"

/* Fixed, so that a newer program finds what an older one has left. */
#define LATCHES_AT ((uint8_t *)0)
#define STARTS_AT ((uint32_t *)4)
#define CHOICE_AT ((uint8_t *)8) /* 1: the second block is in force; else, blank too, the first */
#define BLOCKS_AT ((uint8_t *)16)
#define PART_SIZE 16u

void gh_eeprom_read_latches(uint8_t *latches)
{
    eeprom_read_block(latches, LATCHES_AT, GH_PERSISTENT_SIZE);
}

void gh_eeprom_keep_latches(const uint8_t *latches)
{
    eeprom_update_block(latches, LATCHES_AT, GH_PERSISTENT_SIZE);
}

uint32_t gh_eeprom_count_start(void)
{
    uint32_t starts = eeprom_read_dword(STARTS_AT) + 1; /* a blank cell is 0xFFFFFFFF: the first start is 0 */
    eeprom_update_dword(STARTS_AT, starts);
    return starts;
}

static uint8_t *block_at(bool second)
{
    return BLOCKS_AT + (second ? GH_BLOCK_SIZE : 0u);
}

static bool second_in_force(void)
{
    return eeprom_read_byte(CHOICE_AT) == 1;
}

static bool read_config(bool second, gh_config *config)
{
    uint8_t block[GH_BLOCK_SIZE];
    eeprom_read_block(block, block_at(second), sizeof block);
    return gh_config_read(block, GH_KIND, config);
}

bool gh_eeprom_config(gh_config *config)
{
    if (read_config(second_in_force(), config)) {
        return true;
    }
    memset(config, 0, sizeof *config);
    memset(config->pins, GH_NO_PIN, sizeof config->pins);
    return false;
}

void gh_eeprom_read_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    eeprom_read_block(bytes, block_at(second_in_force()) + part * PART_SIZE, PART_SIZE);
}

void gh_eeprom_write_part(void *context, uint8_t part, uint8_t *bytes)
{
    (void)context;
    uint8_t *at = block_at(!second_in_force()) + part * PART_SIZE;
    eeprom_update_block(bytes, at, PART_SIZE);
    eeprom_read_block(bytes, at, PART_SIZE);
}

bool gh_eeprom_commit(void *context)
{
    gh_config config;
    bool spare = !second_in_force();
    (void)context;
    if (!read_config(spare, &config)) {
        return false;
    }
    eeprom_update_byte(CHOICE_AT, spare ? 1 : 0); /* the only moment: a failure of the power before it changes nothing */
    return true;
}
