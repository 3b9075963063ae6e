#include "cricket.h"

#include <string.h>

static void end_field(cricket *c) {
    bool is_number = c->in_value && c->digits && !c->overflows && c->key_n == 2u;
    if (is_number && c->key[0] == 'S' && c->key[1] == 'P' && c->number <= 0xFFu) {
        c->reply.beacon = (uint8_t)c->number;
        c->has_beacon = true;
    }
    if (is_number && !c->mixed && c->key[0] == 'D' && c->key[1] == 'R' && c->number > 0u) {
        c->reply.us = (uint16_t)c->number;
        c->has_flight = true;
    }
    c->key_n = 0;
    c->in_value = c->digits = c->overflows = c->mixed = false;
    c->number = 0;
}

static void take_digit(cricket *c, uint8_t byte) {
    c->number = (c->digits ? c->number : 0u) * 10u + (uint32_t)(byte - (uint8_t)'0');
    c->overflows = (c->digits && c->overflows) || c->number > 0xFFFFu;
    if (c->overflows) c->number = 0x10000u;
    c->digits = true;
}

static void take_value(cricket *c, uint8_t byte) {
    if (byte >= (uint8_t)'0' && byte <= (uint8_t)'9') {
        take_digit(c, byte);
    } else {
        c->digits = c->overflows = false;
        c->mixed = true;
    }
}

bool cricket_take(cricket *c, uint8_t byte, ping_reply *to) {
    if (byte == (uint8_t)'\n' || byte == (uint8_t)'\r') {
        end_field(c);
        bool whole = c->has_beacon && c->has_flight && c->length < (uint8_t)CRICKET_LINE;
        if (whole) *to = c->reply;
        memset(c, 0, sizeof *c);
        return whole;
    }
    if (c->length < (uint8_t)CRICKET_LINE) ++c->length;
    if (byte == (uint8_t)',') end_field(c);
    else if (c->in_value) take_value(c, byte);
    else if (byte == (uint8_t)'=') c->in_value = true;
    else if (c->key_n < 2u) c->key[c->key_n++] = (char)byte;
    else c->key_n = 3; /* a longer key is none of ours */
    return false;
}
