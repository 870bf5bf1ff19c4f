/* DS18B20: temperatures on a 1-Wire bus. The parts need their own supply at VDD: parasite power needs a strong pull-up
 * during the conversion, which gh_bus.h has not. Datasheet: Maxim DS18B20 19-7487. */
#ifndef GH_DS18B20_H
#define GH_DS18B20_H

#include "gh_bus.h"

#define GH_DS18B20_MAX 8u /* parts on one bus */

typedef enum { GH_DS18B20_MARK, GH_DS18B20_CONVERT, GH_DS18B20_WAIT, GH_DS18B20_READ } gh_ds18b20_state;

typedef struct {
    const gh_one_wire *wire;
    const uint64_t *ids;
    uint32_t start_ms;    /* of the conversion */
    uint8_t scratchpad[9];
    uint8_t count;
    uint8_t state;
    uint8_t position;     /* 0: reset; then 1 more than the byte that is next */
    uint8_t part;
    uint8_t failures;     /* of this part in this cycle */
    uint8_t overwritten;  /* bit for each part: its power-on value is surely gone */
    bool marked;          /* all have been given the mark */
    bool converted;       /* the conversion of this cycle was asked for */
} gh_ds18b20;

/* `ids`: `count` ROM codes (gh_one_wire.h), kept by the caller; more than GH_DS18B20_MAX are not read. The id 0 stands
 * for the only part on the bus: with several, their answers destroy each other. */
void gh_ds18b20_init(gh_ds18b20 *s, const gh_one_wire *wire, const uint64_t *ids, uint8_t count);

/* True for each part once a second, or less often where many parts or slow rounds take longer: 0.01 degC of
 * ids[*part]. At most a reset or 16 slots a call. */
bool gh_ds18b20_step(gh_ds18b20 *s, uint32_t now_ms, uint8_t *part, gh_measurement *temperature);

#endif
