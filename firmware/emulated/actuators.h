/* Between the emulated servo timers and the exported world: of each drive its own, in actuators.c. */
#ifndef ACTUATORS_H
#define ACTUATORS_H
#include <stdint.h>

#include "outputs.h"
#include "world.h"

void actuators_begin(void);

/* Up to time now, by the pulses that are sent. */
void actuators_work(const uint16_t pulses[CHANNELS], int64_t now);

/* What the world is told by them. */
void actuators_command(const uint16_t pulses[CHANNELS], world_in *world);

/* hardware.c: the pulses that are sent. */
const uint16_t *emulated_pulses(void);
#endif
