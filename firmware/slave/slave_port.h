/* What the slave's program asks of its board. A board file writes these functions; nothing else in it is called. */
#ifndef SLAVE_PORT_H
#define SLAVE_PORT_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Time since the start, in units of 100 ns; never falls. */
int64_t slave_now(void);

/* A byte that an ultrasonic unit sent; false where there is none. */
bool slave_unit_read(int unit, uint8_t *byte);

/* Hand bytes to a unit's transmitter, all or none, without waiting; whether there was room. */
bool slave_unit_write(int unit, const uint8_t *bytes, size_t n);

/* Bytes to the other controller over the bus, and from it: whether it acknowledged. They take 1 ms; where the bus hangs,
   they give up after 15. */
bool slave_bus_write(const uint8_t *bytes, size_t n);
bool slave_bus_read(uint8_t *bytes, size_t n);

/* Set the width of the lift fan's pulses, in counts of 1/PULSE_HZ s (pulse.h), from the next frame on. */
void slave_lift(uint16_t counts);

/* Put the hardware watchdog off by its period. Called once a tick, when all of its work was done. */
void slave_kick(void);

/* Sleep until an interrupt. */
void slave_wait(void);
#endif
