#include "ping.h"

enum { HEAD = 3, EACH = 3, AGE = 1000 }; /* bytes before the replies, and of each; unit of the age: 0.1 ms */

bool ping_offer(const ping *p, piece_queue *q, int64_t now) {
    uint8_t data[HEAD + EACH * PING_REPLIES];
    int64_t age = (pieces_begin(q, now) - p->at + AGE / 2) / AGE;
    if (p->unit >= PING_UNITS || p->n > PING_REPLIES || age < 0 || age > 0xFFFF) return false;
    data[0] = p->unit;
    data[1] = (uint8_t)(age & 0xFF);
    data[2] = (uint8_t)(age >> 8);
    for (size_t i = 0; i < p->n; ++i) {
        data[HEAD + EACH * i] = p->replies[i].beacon;
        data[HEAD + EACH * i + 1u] = (uint8_t)(p->replies[i].us & 0xFFu);
        data[HEAD + EACH * i + 2u] = (uint8_t)(p->replies[i].us >> 8);
    }
    return pieces_offer(q, now, MESSAGE_PING, data, HEAD + EACH * (size_t)p->n);
}

bool ping_unpack(const bus_message *m, ping *to) {
    const uint8_t *data = m->data;
    if (m->id != MESSAGE_PING || m->n < (size_t)HEAD || (m->n - HEAD) % EACH != 0u) return false;
    if (m->n > (size_t)(HEAD + EACH * PING_REPLIES) || data[0] >= PING_UNITS) return false;
    to->unit = data[0];
    to->n = (uint8_t)((m->n - HEAD) / EACH);
    to->at = m->at - ((int64_t)data[1] | (int64_t)data[2] << 8) * AGE;
    for (size_t i = 0; i < to->n; ++i) {
        const uint8_t *at = data + HEAD + EACH * i;
        to->replies[i].beacon = at[0];
        to->replies[i].us = (uint16_t)(at[1] | (uint32_t)at[2] << 8);
    }
    return true;
}
