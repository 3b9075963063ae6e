#include "pulse.h"

static uint16_t clipped(double counts) {
    if (!(counts >= PULSE_LOW)) return counts < PULSE_LOW ? PULSE_LOW : PULSE_NEUTRAL; /* the latter: not a number */
    if (counts > PULSE_HIGH) return PULSE_HIGH;
    return (uint16_t)(counts + 0.5);
}

uint16_t pulse_width(double seconds) { return clipped(seconds * PULSE_HZ); }

uint16_t pulse_counts(double counts) { return clipped(counts); }

double pulse_line(const double *x, const double *y, int n, double at) {
    double result = y[0];
    for (int k = 0; k + 1 < n; ++k) {
        double share = (at - x[k]) / (x[k + 1] - x[k]); /* x may fall */
        share = share > 0 ? share : 0;
        result += (share < 1 ? share : 1) * (y[k + 1] - y[k]);
    }
    return result;
}

uint16_t pulse_duty(double duty) {
    if (duty > 1) duty = 1;
    if (duty < -1) duty = -1;
    return clipped(PULSE_NEUTRAL + duty * PULSE_SPAN);
}

double pulse_duty_of(uint16_t counts) {
    double duty = ((double)counts - PULSE_NEUTRAL) / PULSE_SPAN;
    return duty > 1 ? 1 : duty < -1 ? -1 : duty;
}
