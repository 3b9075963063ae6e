#include "rearm.h"

#include <stddef.h>

void rearm_follow(rearm *r, bool failsafe, bool computer) {
    if (failsafe && !r->failsafe) {
        r->failed = true;
        r->confirmed = false;
    } else if (computer) {
        r->failed = false;
    }
    r->failsafe = failsafe;
}

void rearm_note(rearm *r, motion now) {
    r->moments[r->noted % REST_MOMENTS] = now;
    r->noted++;
}

void rearm_confirm(rearm *r) { r->confirmed = true; }

/* A motion that no sensor measures is NAN, which is not above a limit. */
const char *rearm_refusal(const rearm *r, bool confirms) {
    if (!r->failed) return NULL;
    if (!r->confirmed && !confirms) return "failsafe, confirm";
    if (r->noted < REST_MOMENTS) return "motion unknown";
    float speed = 0.0f, rate = 0.0f;
    for (int i = 0; i < REST_MOMENTS; ++i) {
        speed += r->moments[i].speed;
        rate += r->moments[i].rate;
    }
    if (speed > REST_SPEED * (float)REST_MOMENTS) return "it moves";
    if (rate > REST_RATE * (float)REST_MOMENTS) return "it turns";
    return NULL;
}
