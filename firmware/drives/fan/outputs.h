/* Outputs of a fan drive: rudder, speed controller of the thrust fan, lift fan; the safety pilot's receiver. */
#ifndef OUTPUTS_H
#define OUTPUTS_H
#include <stdint.h>

#include "pulse.h"

enum { RUDDER, THRUST, LIFT, CHANNELS };
#define HAS_LIFT
enum { FRAME = 200000 };         /* between pulses, in units of 100 ns */
enum { DRIVE_PARAMETERS = 5 };

/* At rest, in counts: where nobody commands. */
static const uint16_t SAFE_PULSES[CHANNELS] = {PULSE_NEUTRAL, PULSE_NEUTRAL, PULSE_NEUTRAL - PULSE_SPAN};
#endif
