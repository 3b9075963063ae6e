/* A thrust fan whose speed is regulated by its encoder, a rudder servo, a lift fan. speed_regulator: the exported text. */
#ifndef DRIVE_STATE_H
#define DRIVE_STATE_H
#include <stdint.h>

#include "speed_regulator.h"

typedef struct {
    speed_regulator_params params;
    speed_regulator_state state;
    speed_regulator_in in;
    speed_regulator_out out;
    double duty;
    int64_t next;
} drive;
#endif
