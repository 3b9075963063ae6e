/* Servo pulses as counts of a 16-bit timer. */
#ifndef PULSE_H
#define PULSE_H
#include <stdint.h>

enum {
    PULSE_HZ = 2000000,           /* the timer's clock: 0.5 us a count */
    PULSE_FRAME = 40000,          /* counts of a frame: 20 ms */
    PULSE_NEUTRAL = 3000,         /* 1.5 ms */
    PULSE_LOW = 1600,             /* 0.8 ms, the shortest that is ever sent */
    PULSE_HIGH = 4400,            /* 2.2 ms, the longest */
    PULSE_SPAN = 1000             /* 0.5 ms: from neutral to full */
};

/* Width (s) to counts, rounded; neutral for what is no number. */
uint16_t pulse_width(double seconds);

/* Counts, rounded, between the shortest and the longest pulse. */
uint16_t pulse_counts(double counts);

/* y at a place among the n points x, which rise or fall: linear between them, beyond them the ends. */
double pulse_line(const double *x, const double *y, int n, double at);

/* Duty, -1 to 1, to counts from 1 to 2 ms. */
uint16_t pulse_duty(double duty);

/* What a speed controller makes of counts: duty, -1 to 1. */
double pulse_duty_of(uint16_t counts);

static inline double pulse_seconds(uint16_t counts) { return (double)counts / PULSE_HZ; }
static inline uint16_t pulse_us(uint16_t counts) { return (uint16_t)((counts + 1u) / 2u); }
#endif
