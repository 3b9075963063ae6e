/* In step with the autopilot's end (make run LOCKSTEP=1): the board's time stands still until the command of an instant has
   come, so that a flight is the same whatever the computer has to do. */
#ifndef LOCKSTEP_H
#define LOCKSTEP_H
#include "vehicle.h"
#include "world.h"

/* After the world's step to time t. */
void lockstep_instant(vehicle *v, int64_t t, const world_out *out);
#endif
