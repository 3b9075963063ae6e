#include "rearm.h"

#include <stddef.h>

#include "rest.h"

void rearm_follow(rearm *r, bool failsafe, bool computer) {
    if (failsafe && !r->failed) {
        r->failed = true;
        r->confirmed = false;
    } else if (computer) {
        r->failed = false;
    }
}

void rearm_note(rearm *r, motion now) {
    r->moments[r->noted % MOMENTS] = now;
    r->noted++;
}

void rearm_confirm(rearm *r) { r->confirmed = true; }

/* A motion that no sensor measures is NAN, which is not above a limit. */
const char *rearm_refusal(const rearm *r) {
    if (!r->failed) return NULL;
    if (!r->confirmed) return "failsafe, confirm";
    if (r->noted < MOMENTS) return "motion unknown";
    float speed = 0.0f, rate = 0.0f;
    for (int i = 0; i < MOMENTS; ++i) {
        speed += r->moments[i].speed;
        rate += r->moments[i].rate;
    }
    if (speed > REST_SPEED * (float)MOMENTS) return "it moves";
    if (rate > REST_RATE * (float)MOMENTS) return "it turns";
    return NULL;
}
