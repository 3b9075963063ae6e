/* Signed messages in and out. Only what carries a good signature and a stamp that is new gets in; all else is counted. */
#ifndef LINK_H
#define LINK_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dialect.h"
#include "frame.h"

enum { SYSTEM = 1, COMPONENT = 1, KEY_SIZE = 32 };
enum { STAMPS_PER_SECOND = 100000 };

typedef struct {
    uint32_t accepted;
    uint32_t unsigned_frames;
    uint32_t forged;   /* signed with another key, or changed */
    uint32_t replayed; /* good signature, stamp not new */
    uint32_t reflected; /* our own, sent back */
    uint32_t sent;
    uint32_t dropped;  /* messages for which the transmitter had no room */
    uint32_t stale;    /* good signature, by a clock that is behind */
    uint32_t leading;  /* good signature, by a clock that is far ahead */
} link_counts;

/* Whether something was refused whose sender is to be told: of another clock or key. asked: of a question for the time. */
typedef struct {
    bool due;
    int64_t asked;
} link_refusal;

typedef struct {
    framer in;
    mavlink_status_t status;
    mavlink_signing_t signing;
    mavlink_signing_streams_t streams;
    mavlink_message_t parsing;
    uint64_t floor;      /* stamps up to this one are old: they may have been used before the start */
    uint64_t stamp;      /* our own, when it was last set by a message that came */
    int64_t stamped_at;  /* when that was, 100 ns */
    uint64_t anchor;     /* our clock: the first stamp that was believed, carried on; nobody moves it */
    int64_t anchored_at;
    link_counts counts;
    link_refusal refusal;
} link;

void link_begin(link *l, const uint8_t key[KEY_SIZE], uint64_t floor);

/* Take a byte; then call link_next until it gives false. */
void link_take(link *l, uint8_t byte);
bool link_next(link *l, int64_t now, mavlink_message_t *message);

/* Whether somebody with the key has spoken. Before that a board without a calendar has no stamp that others believe. */
static inline bool link_heard(const link *l) { return l->counts.accepted > 0; }

/* Let the stamp go with time. */
void link_tick(link *l, int64_t now);

/* Hand over a message that mavlink_msg_..._encode_status(SYSTEM, COMPONENT, &l->status, ...) has made. */
void link_send(link *l, const mavlink_message_t *message);
#endif
