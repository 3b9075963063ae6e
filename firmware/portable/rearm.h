/* What a vehicle must show before it is armed again after a failsafe: that somebody confirms it, and that it is at rest.
   As trimtab.flight.prearm has it. */
#ifndef REARM_H
#define REARM_H
#include <stdbool.h>
#include <stdint.h>

#include "rest.h"

enum { MOMENT_PERIOD = 1000000 }; /* 100 ms in units of 100 ns */

/* Speed in m/s, rate of turn in rad/s. NAN: no sensor measures it. INFINITY: its sensor has no sample yet. */
typedef struct {
    float speed, rate;
} motion;

typedef struct {
    bool failsafe;  /* in the failsafe now */
    bool failed;    /* the failsafe has stopped the vehicle since it was last flown by a computer */
    bool confirmed; /* somebody has disarmed it since */
    motion moments[REST_MOMENTS];
    unsigned noted;
} rearm;

/* Follow the failsafe's mode, each tick. */
void rearm_follow(rearm *r, bool failsafe, bool computer);

/* Note the motion, each MOMENT_PERIOD. */
void rearm_note(rearm *r, motion now);

void rearm_confirm(rearm *r);

/* Why the vehicle may not be armed again, a word or two; NULL where it may. confirms: the order itself is a confirmation. */
const char *rearm_refusal(const rearm *r, bool confirms);
#endif
