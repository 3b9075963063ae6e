/* A small autopilot in the shape of an exported one: a Kalman filter of position and velocity along a heading, and a law
   that brakes or cruises, with hysteresis. */
#ifndef AUTOPILOT_H
#define AUTOPILOT_H
#include <stdint.h>

typedef double autopilot_real;

typedef struct {
    autopilot_real period;      /* s */
    autopilot_real q;           /* m^2/s^3, intensity of the acceleration noise */
    autopilot_real r;           /* m^2, variance of the measured position */
    autopilot_real gain[2];     /* 1/s^2, 1/s */
    autopilot_real brake_above; /* m/s */
    autopilot_real cruise_below; /* m/s */
} autopilot_params;

typedef struct {
    autopilot_real x[2];    /* m, m/s */
    autopilot_real P[2][2]; /* covariance of x */
    int32_t mode;           /* 0 cruise, 1 brake */
} autopilot_state;

typedef struct {
    autopilot_real acceleration; /* m/s^2 */
    autopilot_real position;     /* m */
    autopilot_real heading;      /* rad */
    int32_t fresh;               /* whether position is new */
} autopilot_in;

typedef struct {
    autopilot_real force[2]; /* N, north and east */
    autopilot_real speed;    /* m/s */
    autopilot_real sigma;    /* m */
    int32_t mode;
} autopilot_out;

void autopilot_defaults(autopilot_params *p);
void autopilot_init(const autopilot_params *p, autopilot_state *s);
void autopilot_step(const autopilot_params *p, autopilot_state *s, const autopilot_in *in, autopilot_out *out);
#endif
