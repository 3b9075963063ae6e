#include "slave.h"

#include <string.h>

#include "pulse.h"
#include "slave_port.h"

enum { LIFT_OFF = PULSE_NEUTRAL - PULSE_SPAN, LIFT_ON = PULSE_NEUTRAL + PULSE_SPAN };

static const uint8_t POLL[] = {'P', '\r', '\n'};

void slave_begin(slave *s) {
    memset(s, 0, sizeof *s);
    s->pulse = LIFT_OFF;
    slave_lift(s->pulse);
}

static bool due(int64_t now, int64_t *next, int64_t period) {
    if (now < *next) return false;
    *next = (now / period + 1) * period;
    return true;
}

/* The first reply of each beacon; what a unit says that was not asked is an echo of an older ping. */
static void take_reply(slave *s, int unit, const ping_reply *r) {
    ping *p = &s->open;
    if (!s->has_pinged || unit != p->unit || p->n == PING_REPLIES) return;
    for (size_t i = 0; i < p->n; ++i)
        if (p->replies[i].beacon == r->beacon) return;
    p->replies[p->n++] = *r;
}

static void listen(slave *s) {
    uint8_t byte;
    ping_reply reply;
    for (int unit = 0; unit < PING_UNITS; ++unit)
        for (int most = 256; most > 0 && slave_unit_read(unit, &byte); --most) /* a flood must not keep the tick waiting */
            if (cricket_take(&s->units[unit], byte, &reply)) take_reply(s, unit, &reply);
}

/* Hand over what came in answer to the last ping, and ask the other unit. */
static void poll(slave *s, int64_t now) {
    uint8_t unit = s->has_pinged ? (uint8_t)((s->open.unit + 1u) % PING_UNITS) : 0u;
    if (s->has_pinged && s->open.n > 0u) (void)ping_offer(&s->open, &s->queue, now);
    s->open.at = now;
    s->open.unit = unit;
    s->open.n = 0;
    s->has_pinged = slave_unit_write(unit, POLL, sizeof POLL);
}

/* A word counts once: a controller that hangs gives the same one again and again. */
static void take_word(slave *s, int64_t now, const uint8_t word[SLAVE_WORD]) {
    bus_message m;
    if (message_unpack(word, SLAVE_WORD, &m) != SLAVE_WORD || m.id != MESSAGE_LIFT) return;
    if (s->has_heard && m.data[1] == s->count) return;
    s->has_heard = true;
    s->heard = now;
    s->count = m.data[1];
    s->lift = m.data[0] == 1u;
}

static void use_slot(slave *s, int64_t now) {
    piece p;
    uint8_t word[SLAVE_WORD];
    if (pieces_next(&s->queue, now, &p) && !slave_bus_write(p.bytes, p.n)) ++s->unacknowledged;
    if (slave_bus_read(word, sizeof word)) take_word(s, now, word);
}

static void drive(slave *s, int64_t now) {
    bool on = s->lift && s->has_heard && now - s->heard < SLAVE_PATIENCE;
    uint16_t wanted = on ? LIFT_ON : LIFT_OFF;
    if (due(now, &s->next_servo, SLAVE_SERVO) || wanted < s->pulse) slave_lift(s->pulse = wanted);
}

void slave_work(slave *s) {
    int64_t now = slave_now();
    listen(s);
    if (!due(now, &s->next_tick, SLAVE_TICK)) return;
    if (due(now, &s->next_poll, SLAVE_POLL)) poll(s, now);
    if (due(now, &s->next_slot, PIECE_SLOT)) use_slot(s, now);
    drive(s, now);
    slave_kick();
}
