/* What an ultrasonic unit heard after a ping, and how it travels from the controller that asked it to the other one. */
#ifndef PING_H
#define PING_H
#include <stdbool.h>
#include <stdint.h>

#include "pieces.h"

enum { PING_UNITS = 2, PING_REPLIES = 6 };

/* Sound in air of 20 deg C and half humidity, m/s: O. Cramer, J. Acoust. Soc. Am. 93(5), 1993. */
#define SOUND_SPEED 343.99

typedef struct {
    uint8_t beacon; /* its number, as in the scenario, from 0 */
    uint16_t us;    /* time of flight */
} ping_reply;

typedef struct {
    int64_t at; /* when the unit pinged, 100 ns */
    uint8_t unit;
    uint8_t n;
    ping_reply replies[PING_REPLIES];
} ping;

/* Queue a ping: its age goes with it, as of the slot in which its first piece will go, for the two clocks differ. */
bool ping_offer(const ping *p, piece_queue *q, int64_t now);

/* A ping on the clock of who received it; false for a message that is none. */
bool ping_unpack(const bus_message *m, ping *to);

static inline double ping_range(const ping_reply *r) { return r->us * 1e-6 * SOUND_SPEED; }
#endif
