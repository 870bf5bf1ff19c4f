/* The buses of gh_bus.h on an AVR at 16 MHz: I2C by its own unit, 1-Wire and single pins by hand, timer 1 counts. */
#ifndef GH_BUSES_H
#define GH_BUSES_H

#include "gh_pins.h"
#include "gh_sensors.h"

/* Fills in `buses`. `wire_pin` is that of the DS18B20, GH_NO_PIN where there is none. */
void gh_buses_start(gh_buses *buses, uint8_t wire_pin);

#endif
