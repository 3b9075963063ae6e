#include "autopilot.h"

#include <math.h>

typedef autopilot_real real;

#define CHOSEN(of_float, of_double, a) (sizeof(real) == sizeof(float) ? (real)of_float((float)(a)) : (real)of_double((double)(a)))

void autopilot_defaults(autopilot_params *p) {
    static const autopilot_params defaults = {(real)0.01, (real)0.5, (real)0.04, {(real)1.5, (real)2.0}, (real)1.2, (real)0.8};
    *p = defaults;
}

void autopilot_init(const autopilot_params *p, autopilot_state *s) {
    s->x[0] = s->x[1] = 0;
    s->P[0][0] = p->r;
    s->P[0][1] = s->P[1][0] = 0;
    s->P[1][1] = 1;
    s->mode = 0;
}

#ifdef LIBRARY_SINE
static real sine(real x) { return CHOSEN(sinf, sin, x); }
static real cosine(real x) { return CHOSEN(cosf, cos, x); }
#else
/* sin x for |x| <= pi: its Taylor series about 0, to x^21. */
static real sine(real x) {
    real y = x * x, sum = 1;
    for (int k = 20; k > 0; k -= 2) sum = 1 - y / (real)(k * (k + 1)) * sum;
    return x * sum;
}
static real cosine(real x) { return 1 - 2 * sine(x / 2) * sine(x / 2); }
#endif

static void predict(const autopilot_params *p, autopilot_state *s, real acceleration) {
    real T = p->period, half = T * T / 2, cross = s->P[0][1] + T * s->P[1][1];
    s->x[0] += T * s->x[1] + half * acceleration;
    s->x[1] += T * acceleration;
    s->P[0][0] += T * (s->P[0][1] + cross) + p->q * T * half / (real)1.5;
    s->P[0][1] = s->P[1][0] = cross + p->q * half;
    s->P[1][1] += p->q * T;
}

static void update(const autopilot_params *p, autopilot_state *s, real position) {
    real S = s->P[0][0] + p->r, K[2] = {s->P[0][0] / S, s->P[0][1] / S}, innovation = position - s->x[0];
    s->x[0] += K[0] * innovation;
    s->x[1] += K[1] * innovation;
    s->P[1][1] -= K[1] * s->P[0][1];
    s->P[0][0] *= 1 - K[0];
    s->P[0][1] = s->P[1][0] = (1 - K[0]) * s->P[0][1];
}

void autopilot_step(const autopilot_params *p, autopilot_state *s, const autopilot_in *in, autopilot_out *out) {
    predict(p, s, in->acceleration);
    if (in->fresh) update(p, s, in->position);
    if (s->x[1] > p->brake_above) s->mode = 1;
    if (s->x[1] < p->cruise_below) s->mode = 0;
    real along = s->mode ? -p->gain[1] * s->x[1] : -p->gain[0] * s->x[0] - p->gain[1] * s->x[1];
    out->force[0] = along * cosine(in->heading);
    out->force[1] = along * sine(in->heading);
    out->speed = s->x[1];
    out->sigma = CHOSEN(sqrtf, sqrt, s->P[0][0]);
    out->mode = s->mode;
}
