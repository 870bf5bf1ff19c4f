"""The MPC's problem solved as what it is: fan on or off, heater in steps of 1/20, with a certified gap."""
